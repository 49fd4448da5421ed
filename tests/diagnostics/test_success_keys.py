"""Environments whose ``info`` does not say ``is_success``, as plug-ins come: never failures in silence."""

import json
import pickle

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from line_environment import LineConfig
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
    assert content["policies"][0]["is_judged"] is False
    shown = told(capsys.readouterr().out)
    assert shown.count("--success-key=succeed") == 1
    assert "? of 3" in shown
    assert "terminated" not in shown, "a success may end an episode"
    status, content = evaluate("--success-key=succeed", f"--output-dir={tmp_path / 'other'}")
    assert (status, content["policies"][0]["successes"]) == (0, 3)
    assert content["environment"]["success_key"] == "succeed"


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


def test_a_key_without_an_environment_is_refused(checkpoint, capsys):
    assert main(["tune", checkpoint, "--dataset=somewhere", "--success-key=succeed"]) == 1
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
