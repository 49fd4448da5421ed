"""``act-chunking check``: what does not fit is told with the fix, and what is too slow for which way."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from small_policies import make_policy, save
from training_runs import record

from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.diagnostics.check import Settings, diagnose, judge
from lerobot_act_chunking.diagnostics.core.fit import Finding, check_fit, check_pose
from lerobot_act_chunking.diagnostics.core.in_time import ways_to_act
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.trained_on import TrainedOn

STATE, FRONT = "observation.state", "observation.images.front"
NAMES = ["pan.pos", "lift.pos"]
KNOWN = TrainedOn(
    30.0,
    dict.fromkeys((STATE, "action"), NAMES),
    {key: [-90.0, -90.0] for key in (STATE, "action")},
    {key: [90.0, 90.0] for key in (STATE, "action")},
)
INPUTS = {
    STATE: PolicyFeature(FeatureType.STATE, (2,)),
    FRONT: PolicyFeature(FeatureType.VISUAL, (3, 48, 64)),
}
CONFIG = SimpleNamespace(
    input_features=INPUTS, output_features={"action": PolicyFeature(FeatureType.ACTION, (2,))}
)


def robot(names=NAMES, camera="front", size=(48, 64, 3)):
    vector = {"dtype": "float32", "shape": (len(names),), "names": list(names)}
    cameras = {f"observation.images.{camera}": {"dtype": "video", "shape": size, "names": None}}
    return {STATE: vector, "action": vector, **cameras}


@pytest.mark.parametrize(
    ("there", "level", "said"),
    [
        (robot(), "pass", "are those of the training"),
        (robot(camera="top"), "fail", "no observation.images.front, but observation.state, observation.im"),
        (
            robot(size=(480, 640, 3)),
            "fail",
            "size (3, 480, 640), but the policy was trained with (3, 48, 64)",
        ),
        (
            robot(NAMES[::-1]),
            "fail",
            "is lift.pos, pan.pos, but the policy was trained with pan.pos, lift.pos",
        ),
        (robot([*NAMES, "grip.pos"]), "fail", "has the size (3,)"),
    ],
)
def test_a_robot_that_differs_is_told(there, level, said):
    found = check_fit(CONFIG, KNOWN, there)
    assert {each.level for each in found} == {level}
    assert said in found[0].text


def test_unknown_names_are_a_warning():
    assert {each.level for each in check_fit(CONFIG, TrainedOn(), robot())} == {"warn"}


@pytest.mark.parametrize(
    ("state", "action", "levels"),
    [
        ([0.0, 0.0], [1.0, 1.0], ["pass"]),
        ([0.0, 0.0], [80.0, 1.0], ["warn"]),  # a jump
        ([2000.0, 0.0], [2000.0, 0.0], ["fail", "pass"]),  # ticks of the encoder, not degrees
    ],
)
def test_units_and_the_first_action(state, action, levels):
    found = check_pose(KNOWN, {STATE: torch.tensor([state])}, np.array(action))
    assert [each.level for each in found] == levels


@pytest.mark.parametrize(
    ("longest_s", "go"),
    [(0.01, [1, 1, 1, 1]), (0.1, [0, 1, 1, 1]), (0.5, [0, 0, 0, 0])],
)
def test_which_ways_of_acting_are_in_time(longest_s, go):
    policy = make_policy(execution="receding")  # chunks of 8 steps: 267 ms
    ways = ways_to_act(policy.policy.config, policy.policy, longest_s, 30)
    assert [each.go for each in ways] == [bool(each) for each in go]
    verdict = judge([], ways).verdict
    assert verdict == ("pass" if all(go) else "warn" if any(go) else "fail")


def test_background_needs_a_mode_that_blends():
    policy = make_policy()
    way = ways_to_act(policy.policy.config, policy.policy, 0.01, 30)[1]
    assert not way.go
    assert "--policy.execution=crossfade" in way.text


def test_the_worst_finding_is_the_verdict():
    found = [Finding("pass", "a"), Finding("warn", "b"), Finding("fail", "c")]
    assert (judge(found, []).verdict, judge(found, []).reasons) == ("fail", ["c"])
    assert judge(found[:2], []).reasons == ["b"]


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    """A checkpoint, and recordings that fit it."""
    folder = tmp_path_factory.mktemp("check")
    inputs = {
        STATE: PolicyFeature(FeatureType.STATE, (6,)),
        "observation.environment_state": PolicyFeature(FeatureType.ENV, (7,)),
    }
    policy = make_policy(inputs=inputs, start=torch.zeros(4))
    policy.policy.config.trained_on = TrainedOn(25.0)
    return save(policy, folder / "policy"), str(record(folder / "data"))


def test_it_acts_on_recordings_and_warns_of_another_rate(checked, tmp_path, capsys):
    checkpoint, data = checked
    assert main(["check", checkpoint, "--dataset", data, "--json", str(tmp_path / "found.json")]) == 0
    found = json.loads((tmp_path / "found.json").read_text())
    assert (found["tool"], found["verdict"], found["fps"]) == ("check", "warn", 50)
    assert any("2 times as fast" in reason for reason in found["reasons"])
    assert found["ticks"]["n"] == 24
    assert found["chunk_s"]["longest"] >= found["chunk_s"]["median"] > 0
    assert "control steps late" in capsys.readouterr().out


def test_statistics_that_do_nothing_fail(checked):
    from lerobot_act_chunking.policies.loading import load_policy

    policy = load_policy(checked[0])
    for step in policy.preprocessor.steps:
        if hasattr(step, "_tensor_stats"):
            step._tensor_stats[STATE] = {"mean": torch.zeros(6), "std": torch.ones(6)}
    report = diagnose(Settings(checked[0], fps=25.0), policy)
    assert report.verdict == "fail"
    assert "do not normalise observation.state" in report.reasons[0]
    assert report.exit_code == 11


def test_a_robot_of_another_kind_is_refused_without_connecting(checked, capsys):
    robot = ["--robot.type=so_arm_sim", "--robot.cameras={front: {width: 64, height: 48}}"]
    assert main(["check", checked[0], *robot]) == 11
    assert "no observation.environment_state" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--robot.type=so_arm_sim", "--robot.colour=red"], "cannot be made"),
        (["--robot.type=so_arm_simm"], "so_arm_sim"),
        (["--robot.port=/dev/null"], "Give --robot.type"),
        (["--connect"], "--connect needs a robot"),
        (["--rename_map=front"], "is no mapping of names"),
    ],
)
def test_robots_that_cannot_be_made_are_refused(checked, options, said, capsys):
    assert main(["check", checked[0], *options]) == 1
    assert said in " ".join(capsys.readouterr().err.split())


ARM = ("type=so_arm_sim", "cameras={wrist: {width: 64, height: 48}}", "seed=3")
ARMS = [
    f"{joint}.pos" for joint in ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
]


@pytest.fixture
def for_the_arm(tmp_path):
    """A checkpoint that fits the simulated SO-101, whose camera it calls ``front``."""
    names = [*ARMS, "gripper.pos"]
    inputs = {
        STATE: PolicyFeature(FeatureType.STATE, (6,)),
        FRONT: PolicyFeature(FeatureType.VISUAL, (3, 48, 64)),
    }
    policy = make_policy(inputs=inputs, start=torch.zeros(6))
    policy.policy.config.trained_on = TrainedOn(
        30.0,
        dict.fromkeys((STATE, "action"), names),
        dict.fromkeys((STATE, "action"), [-180.0] * 6),
        dict.fromkeys((STATE, "action"), [180.0] * 6),
    )
    return policy


def test_one_observation_of_a_connected_arm_is_compared_and_nothing_is_sent(for_the_arm, monkeypatch):
    from lerobot_act_chunking.robots.so_arm_sim import SoArmSim

    sent = []
    monkeypatch.setattr(SoArmSim, "send_action", lambda robot, action: sent.append(action))
    names = {"observation.images.wrist": FRONT}
    report = diagnose(Settings("arm", ARM, connect=True, rename_map=names), for_the_arm)
    told = [each.text for each in report.findings]
    assert "keys, sizes and names are those of the training" in told
    assert any("the first action moves" in each for each in told)
    assert report.fps == 30.0
    assert not sent


def test_other_names_are_refused_where_the_robot_has_none_of_them(for_the_arm):
    report = diagnose(Settings("arm", ARM), for_the_arm)
    assert "there is no observation.images.front" in report.reasons[0]
    with pytest.raises(
        ConfigurationError, match=r"--rename_map renames observation\.images\.side, but there are"
    ):
        diagnose(Settings("arm", ARM, rename_map={"observation.images.side": FRONT}), for_the_arm)
    with pytest.raises(ConfigurationError, match="--rename_map needs a robot or a dataset"):
        Settings("arm", rename_map={"a": "b"})


def test_a_robot_and_a_dataset_are_checked_one_at_a_time(checked):
    with pytest.raises(ConfigurationError, match="one at a time"):
        Settings(checked[0], ("type=so_arm_sim",), checked[1])
