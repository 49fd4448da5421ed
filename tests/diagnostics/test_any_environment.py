"""Instruments run policies in environments that are not this package's, as they do in its own."""

import json
from importlib.util import find_spec

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from matplotlib.image import imread
from small_policies import OURS, make_policy, save
from tiers import full_tier

from lerobot_act_chunking.cli.main import main

LINE = ["--env.discover_packages_path=line_environment", "--env.type=line_of_tests"]
PUSHT = ["--env.type=pusht", "--env.obs_type=environment_state_agent_pos", "--env.episode_length=9"]


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    inputs = {"observation.state": PolicyFeature(FeatureType.STATE, (2,))}
    policy = make_policy(inputs=inputs, start=torch.tensor([0.4, 0.0]), n_action_steps=5)
    return save(policy, tmp_path_factory.mktemp("line"))


@pytest.fixture(scope="module")
def pusht(tmp_path_factory):
    inputs = {
        "observation.state": PolicyFeature(FeatureType.STATE, (2,)),
        "observation.environment_state": PolicyFeature(FeatureType.ENV, (16,)),
    }
    policy = make_policy(inputs=inputs, start=torch.tensor([250.0, 250.0]), n_action_steps=3)
    return save(policy, tmp_path_factory.mktemp("pusht"))


def test_motion_is_drawn_of_what_cannot_be_filmed(checkpoint, tmp_path, capsys):
    outcomes = {}
    for end in (0.2, 9):
        picture = tmp_path / f"{end}.png"
        assert main(["motion", checkpoint, *LINE, f"--env.ends.success={end}", "--out", str(picture)]) == 0
        outcomes[end] = " ".join(capsys.readouterr().out.split())
        assert imread(picture).std() > 0
    assert f"{OURS} on line_of_tests, seed 1000: success after" in outcomes[0.2]
    assert f"{OURS} on line_of_tests, seed 1000: failure after 1.2 s" in outcomes[9]


def test_smoothness_is_measured_of_commands_alone(checkpoint, tmp_path):
    numbers, picture = tmp_path / "numbers.json", tmp_path / "picture.png"
    outputs = ["--json", str(numbers), "--out", str(picture)]
    assert main(["smoothness", checkpoint, *LINE, "--env.ends.success=9", "--episodes", "3", *outputs]) == 0
    content = json.loads(numbers.read_text(), parse_constant=pytest.fail)
    assert content["settings"]["environment"] == {
        "type": "line_of_tests",
        "arguments": {"ends": {"success": 9}},
        "packages": ["line_environment"],
        "success_key": None,
    }
    (source,) = content["sources"]
    assert (source["episodes"], source["steps"], source["dt"], source["successes"]) == (3, 36, 0.1, 0)
    assert list(source["commanded"]["joints"]) == ["action_0", "action_1"]
    assert source["achieved"] is None
    assert source["network_calls_per_episode"] == 3
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("command", ["motion", "smoothness"])
def test_another_robots_policy_is_refused_by_its_sizes(command, checkpoint, capsys):
    assert main([command, checkpoint, *LINE, "--env.width=3"]) == 1
    told = capsys.readouterr().err
    assert "trained with 2 numbers of 'observation.state', the environment line_of_tests has 3" in told


@pytest.mark.skipif(find_spec("gym_pusht") is None, reason="needs gym-pusht")
@pytest.mark.filterwarnings("ignore")  # pygame's and pymunk's
def test_lerobots_own_environments(pusht, tmp_path, capsys):
    picture, numbers = tmp_path / "motion.png", tmp_path / "numbers.json"
    assert main(["motion", pusht, *PUSHT, "--out", str(picture)]) == 0
    assert f"{OURS} on pusht, seed 1000: failure after 0.9 s" in " ".join(capsys.readouterr().out.split())
    assert np.unique(imread(picture)).size > 100
    assert main(["smoothness", pusht, *PUSHT, "--episodes", "2", "--json", str(numbers)]) == 0
    (source,) = json.loads(numbers.read_text())["sources"]
    assert (source["episodes"], source["steps"]) == (2, 18)


@full_tier
@pytest.mark.filterwarnings("ignore")  # of its simulator
def test_an_installed_plug_in_is_swept_and_diagnosed(tmp_path):
    pytest.importorskip("lerobot_env_so101")
    inputs = {
        "observation.state": PolicyFeature(FeatureType.STATE, (14,)),
        "observation.environment_state": PolicyFeature(FeatureType.ENV, (3,)),
    }
    policy = make_policy("act", inputs=inputs, start=torch.zeros(4), n_action_steps=4, dropout=0.0)
    with torch.no_grad():
        for each in policy.policy.parameters():
            each.mul_(0.9)  # of initial weights nothing is tried
    place = save(policy, tmp_path / "policy")
    asked = [
        "--env.type=so101",
        "--success-key=succeed",
        "--env.episode_length=12",
        "--minutes=5",
        "--workers=1",
    ]
    found = {}
    for command, episodes in (("tune", 2), ("diagnose", 10)):
        numbers, out = tmp_path / f"{command}.json", tmp_path / command
        files = [f"--output-dir={out}", "--json", str(numbers)]
        assert main([command, place, *asked, f"--episodes={episodes}", *files]) == 10  # none succeeds
        found[command] = json.loads(numbers.read_text())
    assert sum(each["success"] is not None for each in found["tune"]["candidates"]) > 3
    assert (found["diagnose"]["failures"], found["diagnose"]["success_key"]) == (10, "succeed")
    tried = {each["hypothesis"] for each in found["diagnose"]["interventions"]}
    assert {"chunk too long", "chunk boundary"} <= tried
