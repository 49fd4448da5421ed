from typing import get_args

import numpy as np
import pytest

from lerobot_act_chunking.envs.aloha.experts import ExpertOptions, plan
from lerobot_act_chunking.envs.aloha.options import SuccessRuleName
from lerobot_act_chunking.envs.aloha.rewards import CUBE, LEFT_FINGER, PEG, PIN, RIGHT_FINGER, TABLE
from lerobot_act_chunking.envs.aloha.success import (
    HOLD_STEPS,
    SUCCESS_RULES,
    SuccessRule,
    cube_held,
    make_success_rule,
    peg_held,
)
from lerobot_act_chunking.envs.aloha.world import TASKS, AlohaWorld, sample_object_pose, stock_generator
from lerobot_act_chunking.errors import ConfigurationError

OTHER_LEFT_FINGER = "vx300s_left/10_right_gripper_finger"
INSERTED = frozenset({(PEG, PIN), (PEG, RIGHT_FINGER), ("socket-1", LEFT_FINGER)})


def test_names_match_the_options():
    assert get_args(SuccessRuleName) == SUCCESS_RULES


def test_streak_must_be_unbroken():
    rule = SuccessRule(lambda contacts: bool(contacts), steps=3)
    holding, empty = frozenset({("a", "b")}), frozenset()
    assert [rule.update(c) for c in (holding, holding, empty, holding, holding)] == [False] * 5
    assert rule.update(holding)
    assert rule.update(empty), "an episode that succeeded stays a success"


def test_reset_forgets_success_and_streak():
    rule = SuccessRule(lambda contacts: True, steps=2)
    rule.update(frozenset())
    rule.reset()
    assert not rule.update(frozenset())
    assert rule.update(frozenset())
    rule.reset()
    assert not rule.succeeded


@pytest.mark.parametrize(
    ("contacts", "held"),
    [
        ({(CUBE, LEFT_FINGER)}, True),
        ({(LEFT_FINGER, CUBE), (OTHER_LEFT_FINGER, CUBE)}, True),
        ({(CUBE, LEFT_FINGER), (TABLE, "vx300s_right/7_gripper")}, True),
        ({(CUBE, LEFT_FINGER), (CUBE, TABLE)}, False),
        ({(CUBE, LEFT_FINGER), (CUBE, RIGHT_FINGER)}, False),
        ({(CUBE, LEFT_FINGER), ("vx300s_right/7_gripper", CUBE)}, False),
        ({(CUBE, "vx300s_left/7_gripper")}, False),
        (set(), False),
    ],
)
def test_cube_held_by_the_left_arm_alone(contacts, held):
    assert cube_held(frozenset(contacts)) is held


@pytest.mark.parametrize(
    ("contacts", "held"),
    [
        (INSERTED, True),
        (INSERTED | {(PEG, "socket-2")}, True),
        (INSERTED - {(PEG, PIN)}, False),
        (INSERTED - {(PEG, RIGHT_FINGER)}, False),
        (INSERTED - {("socket-1", LEFT_FINGER)}, False),
        (INSERTED | {(PEG, TABLE)}, False),
        (INSERTED | {("socket-4", TABLE)}, False),
        (INSERTED | {(PIN, TABLE)}, False),
    ],
)
def test_peg_held_in_the_air(contacts, held):
    assert peg_held(frozenset(contacts)) is held


def test_touch_is_reward_4_at_any_step():
    rule = make_success_rule("touch", "transfer_cube")
    assert not rule.update(frozenset({(CUBE, LEFT_FINGER), (CUBE, TABLE)}))
    assert rule.update(frozenset({(CUBE, LEFT_FINGER)}))


def test_hold_takes_ten_steps():
    rule = make_success_rule("hold", "insertion")
    assert HOLD_STEPS == 10
    assert [rule.update(INSERTED) for _ in range(10)] == [False] * 9 + [True]


@pytest.mark.parametrize("task", TASKS)
def test_an_expert_satisfies_touch_first_and_hold_later(task):
    world = AlohaWorld(task)
    world.reset(sample_object_pose(task, stock_generator(5)))
    rules = {name: make_success_rule(name, task) for name in SUCCESS_RULES}
    first: dict[str, int] = {}
    for step, action in enumerate(
        plan(task, world.environment_state(), ExpertOptions(), np.random.default_rng(0)).commands
    ):
        world.step(action)
        for name, rule in rules.items():
            if rule.update(world.contacts()):
                first.setdefault(name, step)
    assert first["hold"] >= first["touch"] + HOLD_STEPS - 1


def test_unknown_names():
    with pytest.raises(ConfigurationError, match="unknown success rule 'grab'; choose one of: touch, hold"):
        make_success_rule("grab", "insertion")
    with pytest.raises(ConfigurationError, match="unknown task"):
        make_success_rule("hold", "pour")
