"""The expert of the SO-101: kinematics, smooth plans, and success for every task and operator."""

import numpy as np
import pytest
from tiers import some

from lerobot_act_chunking.envs.demonstration import ExpertOptions
from lerobot_act_chunking.envs.operators import OPERATORS, get_operator
from lerobot_act_chunking.envs.so_arm.experts import RANGES, plan
from lerobot_act_chunking.envs.so_arm.experts.kinematics import kinematics
from lerobot_act_chunking.envs.so_arm.experts.planner import MAX_STEPS
from lerobot_act_chunking.envs.so_arm.tasks import TASKS, get_task, sample_places
from lerobot_act_chunking.envs.so_arm.world import HOME, SoArmWorld
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.recording.spec import RecordSpec


def places(task="pick_place", seed=5):
    return sample_places(get_task(task), np.random.default_rng(seed))


def planned(task="pick_place", mode=0, **options):
    return plan(task, places(task), ExpertOptions(**options), np.random.default_rng(0), mode=mode)


def home():
    return kinematics().units.to_radians(np.array(HOME))[:5]


def test_inverse_undoes_forward_for_poses_within_reach():
    tools = np.array(
        [[0.2, 0.0, 0.02, 0.0, 0.3], [0.24, -0.1, 0.08, -0.3, -0.5], [0.18, 0.14, 0.05, 0.0, 0.0]]
    )
    for tool, joints in zip(tools, kinematics().inverse(tools, home()), strict=True):
        np.testing.assert_allclose(kinematics().forward(joints), tool, atol=5e-3)


def test_out_of_reach_is_refused_with_the_place():
    with pytest.raises(ConfigurationError, match=r"cannot reach x=0.6 y=0.0 z=0.02 m"):
        kinematics().inverse(np.array([[0.6, 0.0, 0.02, 0.0, 0.0]]), home())


def test_targets_against_gravity_hold_the_joints_that_are_asked_for():
    world = SoArmWorld("pick_place")
    world.reset(places())
    tool = np.array([[0.22, 0.05, 0.08, -0.3, 0.0]])
    joints = kinematics().inverse(tool, home())
    target = np.rad2deg(kinematics().against_gravity(joints)[0])
    world.command(np.array([*target, 10.0]))
    for _ in range(60):
        world.advance()
    np.testing.assert_allclose(world.joints()[:5], np.rad2deg(joints[0]), atol=0.3)
    assert np.abs(target - np.rad2deg(joints[0])).max() > 0.5


@pytest.mark.parametrize("task", TASKS)
def test_plans_begin_and_end_at_home_and_are_smooth(task):
    actions = planned(task).actions
    assert np.abs(actions[-1] - HOME).max() < 8
    assert np.abs(actions[0] - HOME).max() < 8
    assert np.abs(np.diff(actions[:, :5], axis=0)).max() < 6
    assert np.abs(np.diff(actions[:, :5], n=2, axis=0)).max() < 1.5
    assert planned(task).commands is not actions
    np.testing.assert_array_equal(planned(task).commands, actions)


def test_options_do_what_they_say():
    plain = planned().actions
    assert len(planned(speed=1.4).actions) < len(plain) - 40
    assert len(planned(missed_grasps=1).actions) - len(plain) == 36
    assert len(planned(dwell=0.5).actions) - len(plain) == 30
    late = planned(latency=0.1)
    np.testing.assert_array_equal(late.commands[3:], late.actions[:-3])
    noisy = planned(action_noise=1.0)
    np.testing.assert_array_equal(noisy.actions, plain)
    assert 0.5 < (noisy.commands - plain)[:, :5].std() < 1.5
    assert not (noisy.commands - plain)[:, 5].any()


@pytest.mark.parametrize("name", OPERATORS)
def test_every_operators_plans_fit_an_episode(name):
    rng = np.random.default_rng(0)
    for _ in range(3):
        options = get_operator(name).episode(rng, RANGES)
        actions = plan("two_ways", places("two_ways"), options, rng, mode=1).actions
        assert 100 < len(actions) <= MAX_STEPS
        assert np.isfinite(actions).all()


def test_what_cannot_be_planned_is_refused():
    with pytest.raises(ConfigurationError, match="unknown mode of pick_place 1"):
        planned(mode=1)
    with pytest.raises(ConfigurationError, match="places of stack are 14 finite numbers"):
        plan("stack", np.zeros(3), ExpertOptions(), np.random.default_rng(0))
    with pytest.raises(ConfigurationError, match=r"hand_noise=9 is outside 0.0 .. 2.0 degrees"):
        planned(hand_noise=9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "operator"), some(4, [(task, operator) for task in TASKS for operator in OPERATORS])
)
def test_every_operator_succeeds(task, operator):
    source = RecordSpec("me/arm", env="so_arm_sim", task=task, operators=(operator,)).source()
    with source.open() as play:
        successes = sum(play(seed).success for seed in range(12))
    assert successes >= (12 if operator == "steady" else 9)
