"""Recordings of people on real arms, whose lags and parked limbs were measured without these instruments."""

import os
from pathlib import Path

import pytest

from lerobot_act_chunking.diagnostics.resolution.diagnosis import diagnose
from lerobot_act_chunking.diagnostics.resolution.settings import Criteria, Settings
from lerobot_act_chunking.diagnostics.smoothness.comparison import compare
from lerobot_act_chunking.diagnostics.smoothness.settings import EvaluationSpec

RECORDINGS = Path(os.environ.get("ACT_CHUNKING_RECORDINGS", "../shared/data"))


def folder(name):
    if not (RECORDINGS / name).is_dir():
        pytest.skip(f"there is no {RECORDINGS / name}")
    return str(RECORDINGS / name)


@pytest.mark.parametrize(
    ("name", "fps", "frames"),
    [("so101_real", 30, {"elbow": (3, 5)}), ("open50r", 30, {"right.": (25, 29), "right_hand.": (0.5, 1.5)})],
)
def test_lags_are_those_of_the_joints(name, fps, frames):
    (report,) = compare([folder(name)], EvaluationSpec())
    for start, (least, most) in frames.items():
        lags = [
            lag
            for joint, lag in report.tracking_lag_s.items()
            if joint.startswith(start) and joint in report.moving
        ]
        assert lags
        assert all(least <= fps * lag <= most for lag in lags if lag is not None)
    assert not any(joint.startswith("left") for joint in report.moving)


def test_an_arm_moved_by_hand_has_no_lag():
    (report,) = compare([folder("cloth")], EvaluationSpec())
    assert set(report.tracking_lag_s.values()) == {None}
    assert "the state 1 step(s) later" in report.notes[-1]


def test_a_parked_arm_and_quantised_hands_do_not_decide_about_the_stride():
    report = diagnose(Settings(folder("open50r"), Criteria(horizon_s=1.0)))
    assert report.recommended.stride >= 4
    assert len(report.notes) == 2
