"""An observation and a first action against what was demonstrated."""

import numpy as np
import pytest
import torch

from lerobot_act_chunking.diagnostics.core.fit import check_pose
from lerobot_act_chunking.policies.trained_on import TrainedOn

KEYS = ("observation.state", "action")
NAMES = ["reach", "parked"]
KNOWN = TrainedOn(
    30.0,
    dict.fromkeys(KEYS, NAMES),
    low={key: [0.0, 1.0] for key in KEYS},
    high={key: [10.0, 1.0] for key in KEYS},
)


def found(position, action):
    findings = check_pose(KNOWN, {"observation.state": torch.tensor([position])}, np.array(action))
    return [(each.level, each.text.split()[0]) for each in findings], findings[-1].text


@pytest.mark.parametrize("noise", [-0.01, 0.1])
def test_the_noise_of_a_parked_joint_is_no_reason(noise):
    levels, text = found([5.0, 1.0 + noise], [5.5, 1.0])
    assert [level for level, _ in levels] == ["pass"]
    assert "moves" in text


def test_a_joint_in_other_units_and_one_that_was_parked_elsewhere_are_named():
    assert found([80.0, 1.0], [80.0, 1.0])[0][0] == ("fail", "reach")
    assert found([5.0, 3.0], [5.0, 3.0])[0][0] == ("fail", "parked")


def test_a_jump_of_the_first_action_is_warned_of():
    levels, text = found([5.0, 1.0], [8.0, 1.0])
    assert levels == [("warn", "the")]
    assert "moves reach by 3 of a demonstrated 10" in text
