"""The plan in execution, read at the steps that a new chunk predicts; worked out by hand."""

import torch

from lerobot_act_chunking.execution.plan import Plan, covered_steps

STEPS = torch.arange(14.0).reshape(2, 7, 1)  # two environments, seven planned steps: 0 ... 6 and 7 ... 13


def plan(covered, **settings):
    return Plan.from_steps(STEPS, torch.tensor(covered), **{"chunk_stride": 1, "delay": 0, **settings})


def test_a_plan_is_read_at_every_stride_and_holds_its_last_action():
    made = plan([[True] * 6 + [False]], horizon=4, chunk_stride=2)
    assert made.actions[..., 0].tolist() == [[0, 2, 4, 5], [7, 9, 11, 12]]
    assert made.covered.tolist() == [[True, True, True, False]] * 2


def test_a_plan_may_be_longer_than_a_chunk():
    made = plan([[True] * 7], horizon=3)
    assert made.actions[..., 0].tolist() == [[0, 1, 2], [7, 8, 9]]
    assert made.covered.all()


def test_environments_without_a_plan_have_nothing_covered():
    made = plan([[False] * 7, [True, True] + [False] * 5], horizon=3)
    assert made.covered.tolist() == [[False] * 3, [True, True, False]]
    assert made.actions[1, :, 0].tolist() == [7, 8, 8]


def test_a_plan_ends_at_its_first_gap():
    made = plan([[True, False, True, True, True, True, True]], horizon=3)
    assert made.covered.tolist() == [[True, False, False]] * 2


def test_no_plan_at_all_is_none():
    assert plan([[False] * 7], horizon=3) is None


def test_predictions_within_the_delay_are_frozen():
    assert plan([[True] * 7], horizon=4, chunk_stride=2, delay=3).n_frozen == 2
    assert plan([[True] * 7], horizon=4, chunk_stride=2, delay=4).n_frozen == 2
    assert plan([[True] * 7], horizon=3, delay=9).n_frozen == 3
    made = plan([[True, True] + [False] * 5], horizon=4, delay=3)
    assert made.frozen.tolist() == [[True, True, False, False]] * 2


def test_samples_are_repeated_one_after_the_other():
    made = plan([[True] * 7], horizon=2).repeat(3)
    assert made.actions[:, 0, 0].tolist() == [0, 7, 0, 7, 0, 7]
    assert made.covered.shape == (6, 2)


def test_the_first_prediction_behind_the_delay_is_not_frozen():
    steps = torch.arange(14.0).reshape(2, 7, 1)
    plan = Plan.from_steps(steps, torch.ones(1, 7, dtype=torch.bool), horizon=5, chunk_stride=1, delay=2)
    assert plan.frozen.tolist() == [[True, True, False, False, False]] * 2


def test_padding_is_not_plan():
    plan = torch.ones(2, 4, 4)
    plan[0, 1] = 0  # in the middle of a plan: an action like any other
    plan[0, 2, 1:] = 0
    plan[0, 3:] = 0
    plan[1] = 0
    assert covered_steps(plan).tolist() == [[True, True, True, False], [False] * 4]
    assert covered_steps(plan[:, :0]).shape == (2, 0)
