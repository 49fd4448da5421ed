"""The Fetch experts: they succeed, also when disturbed, and can be imitated."""

from itertools import product

import numpy as np
import pytest
from tiers import some

from lerobot_act_chunking.envs.demonstration import ExpertOptions
from lerobot_act_chunking.envs.robotics.env import RoboticsEnv
from lerobot_act_chunking.envs.robotics.experts import EXPERTS, Expert
from lerobot_act_chunking.errors import ConfigurationError

OPTIONS = (
    {"speed": 0.6},
    {"speed": 1.1},
    {"waypoint_noise": 0.03},
    {"action_noise": 0.05},
    {"dwell": 0.3},
)
RELIABLE = ("FetchReach-v4", "FetchPush-v4", "FetchPickAndPlace-v4")


def demonstrate(env, seed, **options):
    """The clean actions and infos of one episode."""
    env.reset(seed=seed)
    expert = Expert(env.task, ExpertOptions(**options), np.random.default_rng(seed), env.max_episode_steps)
    actions, infos, over = [], [], False
    while not over:
        action, command = expert.act(env.named_state)
        *_, terminated, truncated, info = env.step(command)
        actions.append(action)
        infos.append(info)
        over = terminated or truncated
    return np.stack(actions), infos


def successes(task, seeds, **options):
    env = RoboticsEnv(render_mode=None, task=task, success="final")
    count = sum(demonstrate(env, 70_000 + seed, **options)[1][-1]["is_success"] for seed in range(seeds))
    env.close()
    return count


@pytest.mark.parametrize("task", RELIABLE)
def test_clean_experts_succeed_at_the_last_step(task):
    assert successes(task, 20) == 20


@pytest.mark.parametrize(
    ("task", "options"), some(5, product(RELIABLE, OPTIONS), by=lambda case: id(case[1]))
)
def test_options_leave_them_able(task, options):
    assert successes(task, 10, **options) >= 8


@pytest.mark.parametrize("task", EXPERTS)
def test_actions_follow_from_what_is_seen(task):
    env = RoboticsEnv(render_mode=None, task=task, success="final")
    actions, _ = demonstrate(env, 5)
    env.reset(seed=5)
    for action in actions:
        fresh = Expert(task, ExpertOptions(), np.random.default_rng(99), 1)  # knows nothing of the past
        np.testing.assert_array_equal(fresh.act(env.named_state)[0], action)
        env.step(action)
    env.close()
    assert np.abs(actions).max() <= 1


def test_a_faster_expert_is_there_sooner():
    env = RoboticsEnv(render_mode=None, task="FetchPickAndPlace-v4", success="any")
    slow, fast = (len(demonstrate(env, 1, speed=speed)[0]) for speed in (0.5, 1.1))
    assert fast < 0.7 * slow
    env.close()


def test_a_pause_delays_the_grasp_with_open_fingers():
    env = RoboticsEnv(render_mode=None, task="FetchPickAndPlace-v4", success="any")
    (brisk, _), (paused, _) = (demonstrate(env, 1, dwell=dwell) for dwell in (0.0, 0.4))
    closes = int(np.argmax(brisk[:, 3] < 0))
    assert 0 < closes < np.argmax(paused[:, 3] < 0) == closes + 10
    np.testing.assert_array_equal(paused[closes : closes + 10], [[0, 0, 0, 1]] * 10)
    env.close()


@pytest.mark.parametrize(
    ("task", "options", "message"),
    [
        (
            "FrankaKitchen-v1",
            {},
            "unknown task with an expert 'FrankaKitchen-v1'; choose one of: Fetch",
        ),
        (
            "FetchPush-v4",
            {"speed": 1.5},
            "expert option speed=1.5 is outside 0.5 .. 1.1 times the nominal",
        ),
        ("FetchPush-v4", {"action_noise": float("nan")}, "expert option action_noise=nan is outside"),
    ],
)
def test_what_no_expert_can_do_is_refused(task, options, message):
    with pytest.raises(ConfigurationError) as caught:
        Expert(task, ExpertOptions(**options), np.random.default_rng(0), 50)
    assert message in str(caught.value)
