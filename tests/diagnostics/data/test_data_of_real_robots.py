"""Recordings of people on real robots, whose figures were measured without this instrument."""

import os
from pathlib import Path

import pytest

from lerobot_act_chunking.diagnostics.data.diagnosis import diagnose
from lerobot_act_chunking.diagnostics.data.settings import Settings

RECORDINGS = Path(os.environ.get("ACT_CHUNKING_RECORDINGS", "../shared/data"))


def findings(name, cameras="none"):
    if not (RECORDINGS / name).is_dir():
        pytest.skip(f"there is no {RECORDINGS / name}")
    return diagnose(Settings(str(RECORDINGS / name), cameras))


def lags_in_frames(report):
    joints = report.findings.tracking.joints
    return {name: report.recording.fps * lag.seconds for name, lag in joints.items() if lag is not None}


def dimension(report, name, of="actions"):
    return next(each for each in getattr(report.findings, of).behaviours if each.name == name)


@pytest.mark.parametrize("name", ["so101_real", "piper55", "open50r", "cloth", "g1"])
def test_people_command_positions(name):
    assert not findings(name).findings.changes


def test_an_arm_that_waits_at_both_ends():
    report = findings("so101_real")
    rests, states = report.findings.actions.rests, report.findings.states
    assert rests.start_share == pytest.approx(0.178, abs=0.01)
    assert rests.end_share == pytest.approx(0.144, abs=0.01)
    assert (rests.start_longest_s, rests.end_longest_s) == pytest.approx((4.4, 3.1), abs=0.1)
    assert rests.pauses_per_episode == 0
    assert states.rests.pause_share == pytest.approx(0.045, abs=0.01)
    assert report.findings.actions.repeats.share == pytest.approx(0.335, abs=0.005)
    assert report.findings.actions.repeats.longest_s == pytest.approx(4.5, abs=0.1)
    assert states.repeats.share == pytest.approx(0.369, abs=0.005)
    assert all(3.4 <= lag <= 4.4 for lag in lags_in_frames(report).values())
    assert dimension(report, "elbow_flex.pos").at_an_end == pytest.approx((100, 0.35), abs=0.01)
    assert report.findings.actions.jump_frames == 0
    assert report.findings.ways.number is None


def test_an_arm_led_by_another_robot():
    report = findings("piper55")
    rests = report.findings.actions.rests
    assert (rests.start_share, rests.end_share, rests.pause_share) == pytest.approx(
        (0.045, 0.033, 0.004), abs=0.003
    )
    assert rests.pauses_per_episode == pytest.approx(0.11, abs=0.02)
    assert (
        "wrist_flex.pos = joint_5.pos, wrist_roll.pos = joint_6.pos, gripper.pos."
        in report.findings.pair_note
    )
    lags = lags_in_frames(report)
    assert list(lags.values()) == pytest.approx([3.5, 4.8, 4.1, 3.4, 7.4, 2.2], abs=0.3)
    assert report.findings.actions.jump_frames == 26
    assert len(dimension(report, "gripper.pos").jumps) == 26
    assert dimension(report, "joint_2.pos", "states").at_an_end == pytest.approx((-100, 0.17), abs=0.01)


def test_a_parked_arm_and_quantised_hands():
    report = findings("open50r")
    kinds = [each.kind for each in report.findings.actions.behaviours]
    assert kinds.count("constant") == 12
    assert kinds[:7] == ["noise"] * 7
    lags = lags_in_frames(report)
    assert all(25 <= lag <= 29 for name, lag in lags.items() if name.startswith("right."))
    assert all(1 <= lag <= 1.5 for name, lag in lags.items() if name.startswith("right_hand."))
    assert not any(name.startswith("left") for name in lags)
    jumps = {each.name: each.jumps for each in report.findings.actions.behaviours}
    assert sum(map(len, jumps.values())) == 1040
    assert len({place for places in jumps.values() for place in places}) == 805
    assert len(jumps["left.joint_5.pos"]) == 405
    assert report.findings.actions.repeats.share == pytest.approx(0.001, abs=0.001)
    assert any("follows the command late: right." in reason for reason in report.reasons)


def test_arms_moved_by_hand_and_two_dead_cameras():
    report = findings("cloth", "sample")
    (clock,) = [each for each in report.findings.clocks if not each.counted]
    assert clock.rate_hz == pytest.approx(18.5, abs=0.15)
    assert report.findings.tracking.note is not None
    assert report.verdict == "fail"
    first, second = report.findings.cameras
    assert [each.blank for each in first.episodes] == [1.0, *[0.0] * 7]
    assert second.episodes[0].still > 0.5
    assert sum("cam1" in reason and "is frozen" in reason for reason in report.reasons) == 1
    assert second.episodes[0].repeated == pytest.approx(0.25, abs=0.1)
    assert all(
        each.repeated == 0 and each.still < 0.2 for each in (*first.episodes[1:], *second.episodes[1:])
    )


def test_a_humanoid_with_two_lags_and_repeated_pictures():
    report = findings("g1", "sample")
    lags = lags_in_frames(report)
    assert all(3 <= lag <= 4.5 for name, lag in lags.items() if "Hand" not in name)
    assert all(8 <= lag <= 12 for name, lag in lags.items() if "Hand" in name)
    assert dimension(report, "kRightHandThumbBend").at_an_end == pytest.approx((1.0, 0.47), abs=0.01)
    rests = report.findings.actions.rests
    assert (rests.start_share, rests.end_share, rests.pause_share) == (0, 0, 0)
    assert {each.name for each in report.findings.actions.behaviours if each.jumps} == {"kRightHandThumbBend"}
    assert report.findings.actions.jump_frames == 9
    (camera,) = report.findings.cameras
    assert 0.15 <= camera.repeated <= 0.45
    assert max(each.longest_still_s for each in camera.episodes) < 0.5
