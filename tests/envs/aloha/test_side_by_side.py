"""Our world and gym-aloha, stepped side by side: the same numbers, bit for bit."""

import numpy as np
import pytest
from stock import STOCK_TASKS, make_stock, place, smooth_actions

from lerobot_act_chunking.envs.aloha.experts import ExpertOptions, plan
from lerobot_act_chunking.envs.aloha.world import AlohaWorld, sample_object_pose, stock_generator

MOVING_SEEDS = {"transfer_cube": (1, 3, 4), "insertion": (0, 2, 3)}


@pytest.fixture(scope="module", params=STOCK_TASKS)
def pair(request):
    """Both simulators of a task, kept across tests: episodes follow one another on the same instances."""
    return make_stock(request.param), AlohaWorld(request.param)


def start(pair, seed):
    stock, world = pair
    stock.reset(seed=seed)
    world.reset(sample_object_pose(world.task, stock_generator(seed)))
    return stock, world


def step_both(stock, world, actions):
    """Rewards of an episode, after comparing everything after every step."""
    physics = stock._env.physics.data
    rewards = []
    for action in actions:
        observation, reward, *_ = stock.step(action)
        world.step(action)
        assert np.array_equal(physics.qpos, world.data.qpos)
        assert np.array_equal(physics.qvel, world.data.qvel)
        assert np.array_equal(observation["agent_pos"], world.qpos())
        assert np.array_equal(stock._env.task.get_qvel(stock._env.physics), world.qvel())
        assert reward == world.stock_reward()
        rewards.append(reward)
    return rewards


@pytest.mark.parametrize("episode", range(3))
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_random_motion_among_objects_is_identical(pair, episode, dtype):
    seed = MOVING_SEEDS[pair[1].task][episode]
    stock, world = start(pair, seed)
    placed = world.environment_state()
    actions = smooth_actions(world.qpos(), 200, np.random.default_rng(seed))
    step_both(stock, world, actions.astype(dtype))
    settled = np.abs(world.environment_state() - placed)
    assert settled.max() > 0.025, "the objects fell onto the table or were pushed"


@pytest.mark.parametrize("seed", [5, 11])
def test_every_reward_of_an_expert_is_identical(pair, seed):
    stock, world = start(pair, seed)
    expert = plan(world.task, world.environment_state(), ExpertOptions(), np.random.default_rng(seed))
    rewards = step_both(stock, world, expert.commands)
    assert {0, 1, 2, 4} <= set(rewards)


def test_an_episode_that_starts_in_contact_is_identical(pair):
    # Objects tilted and pressed into the table: the contact solver has work from the first step on.
    stock, world = pair
    tilted = [np.cos(0.2), 0.0, np.sin(0.2), 0.0]
    pose = np.array([0.1, 0.5, 0.012, *tilted, -0.1, 0.45, 0.012, *tilted])[: world.environment_state().size]
    place(stock, pose)
    world.reset(pose)
    assert world.data.ncon > 4
    step_both(stock, world, smooth_actions(world.qpos(), 60, np.random.default_rng(0)))


@pytest.mark.parametrize("seed", [0, 7, 2**32 - 1])
def test_a_seed_starts_gym_alohas_own_episode(pair, seed):
    stock, world = start(pair, seed)
    assert np.array_equal(stock._env.physics.data.qpos, world.data.qpos)
    task = stock._env.task
    assert np.array_equal(task.get_qvel(stock._env.physics), world.qvel())
    assert np.array_equal(task.get_env_state(stock._env.physics), world.environment_state())
