"""Environments whose ``info`` does not say ``is_success``, as plug-ins come: never failures in silence."""

import json
import pickle
from pathlib import Path
from shutil import copytree

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from line_environment import LineConfig
from matplotlib.image import imread
from small_policies import make_policy, save

from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.diagnostics.core.digests import environment_identity
from lerobot_act_chunking.diagnostics.core.success_keys import (
    instead_of,
    naming_success,
    never_said,
    success_key,
)

SUCCEED = [
    "--env.discover_packages_path=line_environment",
    "--env.type=line_of_tests",
    "--env.key=succeed",
    "--seed=5",
]
SENTENCE = (
    "the environment line_of_tests never says info['is_success'], so nothing is known of success: it says "
    "succeed; name what means success, as --success-key=succeed, or --success-key=is_success if it speaks "
    "of successes alone"
)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    inputs = {"observation.state": PolicyFeature(FeatureType.STATE, (2,))}
    policy = make_policy(inputs=inputs, start=torch.tensor([0.4, 0.0]), n_action_steps=5)
    return save(policy, tmp_path_factory.mktemp("line"))


def told(text):
    return " ".join(text.split())


@pytest.fixture
def evaluate(checkpoint, tmp_path):
    """`act-chunking eval` with more options: its exit status and its numbers."""

    def evaluate(*options):
        numbers = tmp_path / "numbers.json"
        asked = [*SUCCEED, "--episodes=3", "--workers=1", f"--output-dir={tmp_path / 'out'}"]
        status = main(["eval", checkpoint, *asked, "--json", str(numbers), *options])
        return status, json.loads(numbers.read_text())

    return evaluate


def test_eval_says_once_what_the_environment_calls_it_and_then_counts(evaluate, tmp_path, capsys):
    status, content = evaluate()
    assert (status, content["verdict"], content["reasons"][-1]) == (10, "inconclusive", SENTENCE)
    (policy,) = content["policies"]
    assert [policy[name] for name in ("is_judged", "successes", "interval")] == [False, None, None]
    assert (policy["failures"], policy["failed_seeds"]) == ({}, [])
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Unknown.</strong>" in page
    assert not [each for each in ("0 of 3", "<h2>Failures", "terminated</strong>") if each in page]
    shown = told(capsys.readouterr().out)
    assert shown.count("--success-key=succeed") == 1
    assert "? of 3" in shown
    assert "terminated" not in shown, "a success may end an episode"
    status, content = evaluate("--success-key=succeed", f"--output-dir={tmp_path / 'other'}")
    assert (status, content["policies"][0]["successes"]) == (0, 3)
    assert content["environment"]["success_key"] == "succeed"


def test_what_is_unknown_is_drawn_without_success_and_not_compared(evaluate, checkpoint, tmp_path, capsys):
    picture = tmp_path / "picture.png"
    evaluate("--out", str(picture))
    assert imread(picture).std() > 0
    places = [str(path.parent) for path in (tmp_path / "out").rglob("eval_info.json")]
    info = json.loads((Path(places[0]) / "eval_info.json").read_text(), parse_constant=pytest.fail)
    assert info["per_task"][0]["metrics"]["successes"] == [None] * 3
    assert info["overall"]["pc_success"] is None
    assert [each["success"] for each in info["act_chunking"]["episodes"]] == [None] * 3
    assert main(["compare", f"one={places[0]}", f"other={tmp_path}"]) == 1
    assert "does not know which episodes succeeded" in told(capsys.readouterr().err)


def test_nothing_is_decided_by_what_is_unknown(checkpoint, tmp_path):
    numbers = tmp_path / "numbers.json"
    asked = [*SUCCEED, "--until=decided", "--episodes=9", "--batch-size=3", "--workers=1"]
    places = [f"--output-dir={tmp_path / 'out'}", "--json", str(numbers)]
    assert (
        main(
            ["eval", f"one={checkpoint}", f"other={copytree(checkpoint, tmp_path / 'copy')}", *asked, *places]
        )
        == 10
    )
    content = json.loads(numbers.read_text())
    assert content["reasons"][-1] == SENTENCE
    assert [each["episodes"] for each in content["policies"]] == [3, 3]


def test_results_under_different_keys_are_not_mixed(evaluate, checkpoint, tmp_path, capsys):
    evaluate()
    asked = [*SUCCEED, "--episodes=3", "--workers=1", f"--output-dir={tmp_path / 'out'}"]
    assert main(["eval", checkpoint, *asked, "--success-key=succeed"]) == 1
    assert "holds episodes of another environment" in told(capsys.readouterr().err)


@pytest.mark.parametrize("key", ["suceed", "is_success"])
def test_a_key_that_is_not_there(key, evaluate, capsys):
    status, content = evaluate(f"--success-key={key}")
    if key == "is_success":  # it was asked for: silence is no success
        assert (status, content["policies"][0]["successes"], content["policies"][0]["is_judged"]) == (
            0,
            0,
            True,
        )
    else:
        assert status == 10
        assert (
            "never says info['suceed'], so nothing is known of success: it says succeed"
            in (content["reasons"][-1])
        )


@pytest.mark.parametrize("command", ["tune", "diagnose"])
def test_what_goes_by_success_alone_is_refused(command, checkpoint, tmp_path, capsys):
    asked = [*SUCCEED, "--episodes=4", "--workers=1", f"--output-dir={tmp_path}"]
    assert main([command, checkpoint, *asked]) == 1
    assert SENTENCE in told(capsys.readouterr().err)
    numbers = tmp_path / "numbers.json"
    assert main([command, checkpoint, *asked, "--success-key=succeed", "--json", str(numbers)]) in (0, 10, 11)
    assert json.loads(numbers.read_text())["success_key"] == "succeed"


def test_modes_still_says_the_ways(checkpoint, tmp_path):
    numbers = tmp_path / "numbers.json"
    for key, note in (("", 1), ("succeed", 0)):
        named = [f"--success-key={key}"] if key else []
        main(["modes", checkpoint, *SUCCEED, *named, "--episodes=2", "--json", str(numbers)])
        notes = json.loads(numbers.read_text())["notes"]
        assert sum("never says info['is_success']" in each for each in notes) == note


def test_smoothness_is_measured_all_the_same(checkpoint, tmp_path, capsys):
    numbers = tmp_path / "numbers.json"
    for key, successes, note in (("", None, [SENTENCE]), ("succeed", 2, [])):
        named = [f"--success-key={key}"] if key else []
        assert main(["smoothness", checkpoint, *SUCCEED, *named, "--episodes=2", "--json", str(numbers)]) == 0
        content = json.loads(numbers.read_text())
        assert content["settings"]["environment"]["success_key"] == (key or None)
        (source,) = content["sources"]
        assert (source["successes"], [each for each in source["notes"] if "success" in each]) == (
            successes,
            note,
        )
        assert source["commanded"]["arms"]["rms_jerk"] > 0


def test_the_motion_is_drawn_all_the_same(checkpoint, tmp_path, capsys):
    for key, outcome in (("", "success unknown"), ("succeed", "success")):
        named = [f"--success-key={key}"] if key else []
        assert main(["motion", checkpoint, *SUCCEED, *named, "--out", str(tmp_path / "motion.png")]) == 0
        shown = told(capsys.readouterr().out)
        assert f"on line_of_tests, seed 5: {outcome} after" in shown
        assert (SENTENCE in shown) == (not key)


@pytest.mark.parametrize("command", ["tune", "motion", "smoothness"])
def test_a_key_without_an_environment_is_refused(command, checkpoint, capsys):
    more = ["--dataset=somewhere"] if command == "tune" else []
    assert main([command, checkpoint, *more, "--success-key=succeed"]) == 1
    assert "--success-key=succeed is of which environment?" in told(capsys.readouterr().err)


def test_the_key_goes_wherever_the_configuration_goes():
    config = pickle.loads(pickle.dumps(naming_success(LineConfig(), "succeed")))
    assert success_key(config) == "succeed"
    assert environment_identity(config)["success_key"] == "succeed"
    assert "success_key" not in environment_identity(LineConfig())
    assert success_key(LineConfig()) == "is_success"


def test_one_that_says_nothing_at_all_may_speak_of_successes_alone():
    config = LineConfig()
    assert instead_of(config, {"is_success"}) is None
    assert instead_of(config, set()) == []
    assert never_said(config, [[], None]) is None
    assert "it says nothing at all, or --success-key=is_success if" in (never_said(config, [[], []]) or "")
    assert instead_of(naming_success(config, "is_success"), set()) is None
