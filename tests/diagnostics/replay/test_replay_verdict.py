"""Each fault has its own verdict, its reason and what to change."""

from dataclasses import replace

import numpy as np
import pytest

from lerobot_act_chunking.diagnostics.replay.execution import Gripper, Hesitations
from lerobot_act_chunking.diagnostics.replay.horizon import Following
from lerobot_act_chunking.diagnostics.replay.verdict import judge

GOOD = Following(
    errors={"policy": 0.1, "hold_still": 0.8, "nearest": 0.2, "mean_action": 0.8},
    against_nearest=(0.5, 0.4, 0.6),
    reduction=0.8,
    correlation=0.9,
    departure=0.95,
    departure_state=0.95,
    variation=1.0,
    outside=np.zeros(2),
)
SWIFT = Gripper("jaw", 10, (0.02,) * 10, 0, 0)
STEADY = Hesitations(0.0, 0.0, 0.0)


def judged(following=GOOD, gripper=SWIFT, hesitations=STEADY, learned=False, n=200):
    return judge(following, [gripper], hesitations, ["lift", "jaw"], learned, n)


def test_a_good_policy_passes():
    assert judged().verdict == "pass"
    assert "only episodes" in judged().reasons[0]


@pytest.mark.parametrize(
    ("changes", "verdict", "reason"),
    [
        ({"outside": np.array([0.9, 0.0])}, "fail", "most predictions of lift are far from everything"),
        ({"variation": 0.05}, "fail", "nearly the same everywhere (spread 5%"),
        ({"departure": 0.1}, "fail", "repeats its last action: in the first half second it goes 10%"),
        ({"departure_state": 0.1}, "fail", "repeats the current state"),
        (
            {"errors": {**GOOD.errors, "policy": 0.9}},
            "fail",
            "no nearer to the demonstrator than holding",
        ),
        (
            {"errors": {**GOOD.errors, "policy": 0.7, "mean_action": 0.6}},
            "fail",
            "always doing the mean action",
        ),
        ({"against_nearest": (1.5, 1.2, 1.9)}, "fail", "1.50 times that of repeating the nearest"),
        ({"against_nearest": (1.1, 0.8, 1.4)}, "warn", "under-trained, or has too little data"),
    ],
)
def test_chunks_that_do_not_follow(changes, verdict, reason):
    judgement = judged(replace(GOOD, **changes))
    assert judgement.verdict == verdict
    assert len(judgement.reasons) == 1
    assert reason in judgement.reasons[0]


@pytest.mark.parametrize(
    ("gripper", "verdict", "reason"),
    [
        (Gripper("jaw", 4, (0.3,) * 4, 0, 0), "warn", "jaw switches 0.30 s too late"),
        (Gripper("jaw", 4, (-0.8,) * 4, 0, 0), "fail", "jaw switches 0.80 s too early"),
        (Gripper("jaw", 4, (0.0,) * 3, 1, 0), "warn", "does not switch at 1 of 4"),
        (Gripper("jaw", 4, (), 4, 0), "fail", "does not switch at 4 of 4"),
    ],
)
def test_grippers(gripper, verdict, reason):
    judgement = judged(gripper=gripper)
    assert judgement.verdict == verdict
    assert reason in judgement.reasons[0]


def test_rests_and_episodes_that_were_learned_are_warnings():
    assert judged(hesitations=Hesitations(0.1, 0.0, 1.5)).verdict == "warn"
    assert judged(learned=True).verdict == "warn"
    assert "hold some out" in judged(learned=True).reasons[0]


def test_too_little_to_judge_by():
    assert judged(n=29).verdict == "inconclusive"
    assert judged(following=None).verdict == "inconclusive"
