"""Diagnoses whose answers are known: policies that say what a function says, with a fault that is planted."""

import json

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from small_policies import make_policy, save

from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec
from lerobot_act_chunking.diagnostics.core.executable import Executable
from lerobot_act_chunking.diagnostics.core.outcomes import FILE
from lerobot_act_chunking.diagnostics.diagnose import diagnosis
from lerobot_act_chunking.diagnostics.diagnose.diagnosis import diagnose
from lerobot_act_chunking.diagnostics.diagnose.settings import Settings
from lerobot_act_chunking.errors import ConfigurationError

LINE = EnvironmentSpec("line_of_tests", packages=("line_environment",))
ON, BACK = 1.0, -1.0
UNIT = 0.05  # of the postprocessor


@pytest.fixture
def plan(monkeypatch, tmp_path):
    """Diagnoses a policy whose every chunk goes these eight ways, in a world where going on is success."""

    def plan(ways, folder="kept", episodes=20, minutes=5.0, **settings):
        inputs = {"observation.state": PolicyFeature(FeatureType.STATE, (2,))}
        policy = make_policy(inputs=inputs, start=torch.zeros(2), **settings)
        chunk = torch.tensor(ways)[:, None] * torch.tensor([1.0, 0.0]) / UNIT
        policy.policy._prepare = lambda window, envs, n_steps, delay: (
            lambda: chunk[:n_steps].repeat(window.batch_size, 1, 1)
        )
        subject = Executable(save(policy, tmp_path / "policy"), policy.policy.config, wrapped=False)
        monkeypatch.setattr(Executable, "load", lambda _: policy)
        monkeypatch.setattr(diagnosis, "read_executable", lambda _: subject)
        asked = Settings(
            subject.checkpoint,
            LINE,
            episodes=episodes,
            minutes=minutes,
            batch_size=10,
            output_dir=tmp_path / folder,
        )
        return diagnose(asked)

    monkeypatch.setattr("lerobot_act_chunking.diagnostics.diagnose.looking.untrained", lambda _: None)
    return plan


def names(report):
    return [each.name for each in report.causes]


def test_a_healthy_policy_gives_no_alarm(plan):
    report = plan([ON] * 8, episodes=100)
    assert report.verdict == "pass"
    assert report.effects == []


def test_a_chunk_that_is_used_for_too_long(plan):
    report = plan([ON, ON, *[BACK] * 6])
    assert report.failures.successes >= 10
    assert (report.verdict, names(report)) == ("fail", ["chunk too long"])
    assert "--policy.n_action_steps=2" in report.causes[0].repair
    assert report.repeats
    assert 0 <= report.good_until_s <= 1.2


def test_a_chunk_that_is_given_up_too_soon(plan):
    report = plan([BACK, ON, *[ON] * 6], n_action_steps=2)
    assert names(report) == ["chunk too short"]
    assert "--policy.n_action_steps=8" in report.causes[0].repair


def test_an_ensemble_that_blurs(plan):
    report = plan([ON, *[BACK] * 7], execution="ensemble", replan_interval=1)
    assert names(report) == ["over-smoothing"]
    assert "--policy.execution=receding" in report.causes[0].repair


def test_none_of_these(plan):
    report = plan([BACK] * 8)
    assert report.verdict == "inconclusive"
    assert "none of these" in report.reasons[0]
    assert set(report.measured.given_up.values()) == {8}


def test_a_stopped_diagnosis_goes_on_to_the_same_answer(plan, tmp_path):
    ways = [ON, ON, *[BACK] * 6]
    assert "time ended" in plan(ways, "stopped", minutes=1e-9).reasons[0]
    first, again = plan(ways, "stopped"), plan(ways, "stopped")
    kept = (tmp_path / "stopped" / FILE).read_bytes()
    whole = plan(ways, "whole")
    for other in (again, whole):
        assert {**other.to_json(), "minutes": 0, "checkpoint": ""} == {
            **first.to_json(),
            "minutes": 0,
            "checkpoint": "",
        }
    assert (tmp_path / "stopped" / FILE).read_bytes() == kept
    more = plan(ways, "stopped", minutes=1e-9)
    assert names(more) == ["chunk too long"]  # all is there: no time is needed


def test_the_command(tmp_path, capsys):
    inputs = {"observation.state": PolicyFeature(FeatureType.STATE, (2,))}
    checkpoint = save(make_policy(inputs=inputs, start=torch.tensor([-0.4, 0.0])), tmp_path / "policy")
    numbers, picture = tmp_path / "numbers.json", tmp_path / "picture.png"
    asked = ["diagnose", checkpoint, "--env.discover_packages_path=line_environment"]
    asked += ["--env.type=line_of_tests", "--episodes", "12", "--workers", "1"]
    asked += ["--output-dir", str(tmp_path / "kept"), "--json", str(numbers), "--out", str(picture)]
    assert main(asked) == 11
    out = " ".join(capsys.readouterr().out.split())
    assert "12 of 12 episodes fail" in out
    assert "untrained: give a checkpoint of a finished lerobot-train" in out
    content = json.loads(numbers.read_text(), parse_constant=pytest.fail)
    assert (content["tool"], content["verdict"]) == ("diagnose", "fail")
    assert content["causes"][0]["name"] == "untrained"
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_nothing_to_measure_by_is_refused():
    with pytest.raises(ConfigurationError, match=r"--env.type .* or .*--dataset"):
        Settings("somewhere")
    with pytest.raises(ConfigurationError, match="episodes"):
        Settings("somewhere", LINE, episodes=0)
