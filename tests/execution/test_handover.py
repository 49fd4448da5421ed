"""The transition from what is left of a chunk to a new one; worked out by hand."""

import pytest
import torch

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.execution.handover import hand_over

OLD, NEW = torch.zeros(1, 6, 2), torch.full((1, 9, 2), 12.0)
COVERED = torch.tensor([[True] * 5 + [False]])


def handed_over(delay, covered=COVERED, **settings):
    return hand_over(NEW, OLD, covered, delay, ExecutionSettings(9, **settings))[0, :, 0].tolist()


def test_the_old_chunk_while_the_new_one_is_computed_then_a_linear_transition():
    assert handed_over(2, execution="crossfade", crossfade_steps=2) == [0, 0, 4, 8, 12, 12, 12, 12, 12]


def test_a_transition_is_no_longer_than_what_is_left():
    long = handed_over(2, execution="crossfade", replan_interval=1, crossfade_steps=7)
    assert long == [0, 0, 3, 6, 9, 12, 12, 12, 12]
    assert handed_over(2, execution="ensemble") == long


@pytest.mark.parametrize("mode", ["receding", "open_loop"])
def test_modes_that_do_not_blend_go_over_at_once(mode):
    assert handed_over(2, execution=mode) == [0, 0, *[12.0] * 7]


def test_a_chunk_that_is_late_beyond_the_plan_is_gone_over_to_from_its_last_action():
    assert handed_over(8, execution="crossfade", crossfade_steps=1) == [*[0.0] * 8, 6.0]


def test_without_a_plan_it_is_the_new_chunk():
    assert handed_over(2, covered=torch.zeros(1, 6, dtype=torch.bool), execution="crossfade") == [12.0] * 9


def test_grippers_go_over_at_once():
    settings = ExecutionSettings(9, execution="crossfade", crossfade_steps=2, gripper_dims=(1,))
    assert hand_over(NEW, OLD, COVERED, 2, settings)[0, :, 1].tolist() == [0, 0, *[12.0] * 7]


def test_environments_have_plans_of_their_own():
    covered = torch.tensor([[True] * 6, [True] + [False] * 5])
    settings = ExecutionSettings(9, execution="receding")
    both = hand_over(NEW.repeat(2, 1, 1), OLD.repeat(2, 1, 1), covered, 3, settings)[:, :, 0]
    assert both.tolist() == [[0, 0, 0, *[12.0] * 6], [0, *[12.0] * 8]]


def test_an_old_chunk_that_ends_before_the_new_one_is_used_is_left_smoothly():
    """LeRobot's engine tells of ten steps at most, and a client may have run out altogether."""
    told = handed_over(6, execution="crossfade", replan_interval=1, crossfade_steps=7)
    assert told == [*[0.0] * 6, 3.0, 6.0, 9.0]
    at_once = handed_over(6, execution="receding", replan_interval=1)
    assert at_once == [*[0.0] * 5, *[12.0] * 4]
