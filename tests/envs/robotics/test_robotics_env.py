"""RoboticsEnv: the original's physics and rewards, LeRobot's observations and success."""

import sys
from functools import partial
from itertools import product

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from tiers import some

from lerobot_act_chunking.envs.robotics.env import RoboticsEnv
from lerobot_act_chunking.envs.robotics.original import make_original
from lerobot_act_chunking.envs.robotics.tasks import TASKS, get_task
from lerobot_act_chunking.errors import ConfigurationError, FeatureError

SMALL = {"observation_height": 24, "observation_width": 32, "render_quality": "fast"}
# One of each family: bare goals, goals in a dictionary, no goals.
FAMILIES = ("FetchPush-v4", "FrankaKitchen-v1", "AdroitHandPen-v1", "HandManipulateBlock-v1")


@pytest.fixture
def make():
    """Make environments that are closed after the test."""
    made = []

    def build(task="FetchReach-v4", **options):
        made.append(RoboticsEnv(task=task, **options))
        return made[-1]

    yield build
    for env in made:
        env.close()


def actions(env, seed, steps):
    shape = (steps, *env.action_space.shape)
    return np.random.default_rng(seed).uniform(-1, 1, shape).astype(np.float32)


def rollout(env, seed, steps=25, look=lambda: None):
    """Everything a state policy is given in an episode of random actions, and the rewards."""
    observation, _ = env.reset(seed=seed)
    rows = [np.r_[observation["agent_pos"], observation["environment_state"], 0.0]]
    for action in actions(env, seed, steps):
        look()
        observation, reward, *_ = env.step(action)
        rows.append(np.r_[observation["agent_pos"], observation["environment_state"], reward])
    return np.stack(rows)


def to_the_goal(env, observation):
    """Move Fetch's gripper straight to the goal."""
    error = observation["environment_state"][-3:] - observation["agent_pos"][:3]
    return np.append(np.clip(error / 0.05, -1, 1), 0).astype(np.float32)


# Gymnasium would like bounds; positions and velocities have none in the originals either.
@pytest.mark.filterwarnings("ignore:.*(infinity|inf).*:UserWarning")
@pytest.mark.parametrize(
    ("options", "task"),
    some(4, product([{}, {"obs_type": "pixels", **SMALL}, {"obs_type": "pixels_state", **SMALL}], FAMILIES)),
)
def test_gymnasiums_checker_passes(options, task):
    env = gym.make(f"gymnasium_robotics/{task}", visualization_height=24, visualization_width=32, **options)
    check_env(env.unwrapped)
    assert env.get_wrapper_attr("_max_episode_steps") == get_task(task).episode_length
    env.close()


@pytest.mark.parametrize("task", TASKS)
def test_same_seed_same_episode_to_the_bit_even_after_others(make, task):
    env, other = make(task, success="final"), make(task, success="final")
    episode = rollout(env, seed=4)
    assert np.array_equal(rollout(other, seed=4), episode)
    assert not np.array_equal(rollout(env, seed=5), episode)
    assert np.array_equal(rollout(env, seed=4), episode)


@pytest.mark.parametrize("task", [*FAMILIES, "FetchPickAndPlace-v4"])
def test_looking_does_not_change_what_happens(make, task):
    seen = make(task, success="final", visualization_height=24, visualization_width=32, render_quality="fast")
    assert np.array_equal(
        rollout(seen, seed=4, look=seen.render), rollout(make(task, success="final"), seed=4)
    )


@pytest.mark.parametrize("task", FAMILIES)
def test_physics_and_rewards_are_the_originals(make, task):
    env, original = make(task, success="final"), make_original(task)
    observation, _ = env.reset(seed=7)
    expected, _ = original.reset(seed=7)
    for action in actions(env, 7, 20):
        observation, reward, terminated, *_ = env.step(action)
        expected, stock_reward, stock_terminated, *_ = original.step(action)
        state, environment = get_task(task).split(expected)
        assert np.array_equal(observation["agent_pos"], state)
        assert np.array_equal(observation["environment_state"], environment)
        assert (reward, terminated) == (float(stock_reward), stock_terminated)
    original.close()


def test_unseeded_resets_continue_a_seeded_sequence(make):
    def goals(env):
        env.reset(seed=8)
        return [tuple(env.reset()[0]["environment_state"]) for _ in range(3)]

    first = goals(make())
    assert goals(make()) == first
    assert len(set(first)) == 3


@pytest.mark.parametrize(
    ("options", "keys"),
    [
        ({}, {"agent_pos", "environment_state"}),
        ({"obs_type": "pixels", **SMALL}, {"pixels"}),
        ({"obs_type": "pixels_state", **SMALL}, {"agent_pos", "pixels"}),
    ],
)
def test_observation_keys(make, options, keys):
    env = make(**options)
    observation, info = env.reset(seed=0)
    assert set(observation) == keys
    assert info == {"is_success": False, "success_any": False, "success_final": False}
    assert env.observation_space.contains(observation)


@pytest.mark.parametrize(("task", "sizes"), [("FetchPush-v4", (5, 12)), ("FrankaKitchen-v1", (9, 38))])
def test_velocities_can_be_left_out(make, task, sizes):
    env, complete = make(task, velocities=False), make(task)
    for each in (env, complete):
        each.reset(seed=3)
    for _ in range(3):
        action = np.full(env.action_space.shape, 0.3, np.float32)
        observation, complete_observation = (each.step(action)[0] for each in (env, complete))
    assert env.observation_space.contains(observation)
    assert tuple(observation[key].size for key in ("agent_pos", "environment_state")) == sizes
    kept = [i for i, name in enumerate(complete.layout.state_names) if "vel" not in name]
    assert np.array_equal(observation["agent_pos"], complete_observation["agent_pos"][kept])
    state = complete.named_state
    assert env.named_state.keys() == state.keys()
    assert all(np.array_equal(env.named_state[name], value) for name, value in state.items())


def reach(env, seed, leave_after=None):
    """Infos and ends of an episode that goes to the goal and, after so many steps, away from it."""
    observation, _ = env.reset(seed=seed)
    infos, over = [], False
    while not over:
        away = leave_after is not None and len(infos) >= leave_after
        action = np.array([-1, -1, 1, 0], np.float32) if away else to_the_goal(env, observation)
        observation, _, terminated, truncated, info = env.step(action)
        infos.append(info)
        over = terminated or truncated
    return infos, terminated, truncated


def test_any_ends_at_the_first_step_that_succeeds(make):
    infos, terminated, truncated = reach(make(success="any"), seed=1)
    assert (terminated, truncated) == (True, False)
    assert [info["is_success"] for info in infos] == [False] * (len(infos) - 1) + [True]
    assert 1 < len(infos) < 50
    assert infos[-1] == {"is_success": True, "success_any": True, "success_final": True}


def test_final_waits_for_the_last_step(make):
    infos, terminated, truncated = reach(make(success="final"), seed=1)
    assert (terminated, truncated, len(infos)) == (False, True, 50)
    assert [info["is_success"] for info in infos] == [False] * 49 + [True]
    assert infos[-2] == {"is_success": False, "success_any": True, "success_final": True}


def test_a_goal_that_was_left_again_counts_for_any_alone(make):
    infos, *_ = reach(make(success="final"), seed=1, leave_after=20)
    assert infos[19]["success_final"]
    assert infos[-1] == {"is_success": False, "success_any": True, "success_final": False}
    assert reach(make(success="any"), seed=1, leave_after=20)[0][-1]["is_success"]


def test_a_shorter_episode_moves_the_final_step(make):
    infos, _, truncated = reach(make(success="final", episode_length=12), seed=1)
    assert (truncated, len(infos)) == (True, 12)
    assert infos[-1]["is_success"]


def test_the_kitchen_succeeds_when_nothing_is_left_to_do(make):
    env = make("FrankaKitchen-v1")
    env.reset(seed=0)
    env.original.tasks_to_complete = set()
    env.original.episode_task_completions[:] = env.original.goal
    *_, terminated, truncated, info = env.step(np.zeros(9, np.float32))
    assert (terminated, truncated, info["is_success"]) == (True, False, True)


def test_adroits_success_is_the_originals(make):
    env = make("AdroitHandDoor-v1")
    env.reset(seed=0)
    env.original.data.joint("door_hinge").qpos = 1.5
    *_, terminated, _, info = env.step(np.zeros(28, np.float32))
    assert (terminated, info["is_success"]) == (True, True)


def test_fetchs_episodes_differ_by_seed_alone_in_a_vector(make):
    build = partial(gym.make, "gymnasium_robotics/FetchSlide-v4", disable_env_checker=True)
    envs = gym.vector.SyncVectorEnv([build] * 2, autoreset_mode=gym.vector.AutoresetMode.SAME_STEP)
    observation, info = envs.reset(seed=[6, 7])
    assert info["is_success"].tolist() == [False, False]
    for index, seed in enumerate((6, 7)):
        alone = make("FetchSlide-v4").reset(seed=seed)[0]
        assert np.array_equal(observation["environment_state"][index], alone["environment_state"])
    envs.close()


def test_words_and_clock(make):
    env = make("AdroitHandHammer-v1")
    assert env.task_description == "Pick up the hammer and drive the nail into the board."
    assert env.metadata["render_fps"] == 100
    assert RoboticsEnv.metadata["render_fps"] == 25, "an instance's rate is its own"


def test_refusals(make):
    with pytest.raises(
        ConfigurationError, match="unknown render_mode 'human'; choose one of: rgb_array, None"
    ):
        make(render_mode="human")
    with pytest.raises(ConfigurationError, match="unknown camera 'side'; choose one of: view, left_cap"):
        make("FrankaKitchen-v1", obs_type="pixels", cameras=["side"])
    env = make()
    env.reset(seed=0)
    with pytest.raises(FeatureError, match=r"an action of FetchReach-v4 has shape \(4,\), got \(3,\)"):
        env.step(np.zeros(3))
    with pytest.raises(FeatureError, match="the action is not finite at z, gripper"):
        env.step(np.array([0, 0, np.nan, np.inf]))


def test_a_missing_package_names_its_command(monkeypatch, make):
    monkeypatch.setitem(sys.modules, "gymnasium_robotics", None)
    with pytest.raises(ConfigurationError, match=r"needs .*: pip install 'gymnasium-robotics>=1.4,<2'"):
        make()


def test_a_release_without_the_task_names_its_command(monkeypatch, make):
    monkeypatch.delitem(gym.registry, "FetchReach-v4")
    with pytest.raises(
        ConfigurationError, match=r"has no FetchReach-v4 .*pip install 'gymnasium-robotics>=1.4,<2'"
    ):
        make()


def test_a_missing_model_file_names_its_command(monkeypatch, make):
    def absent(path):
        raise ValueError("Error opening file 'stls/fetch/base_link_collision.stl'")

    monkeypatch.setattr(mujoco.MjModel, "from_xml_path", absent)
    with pytest.raises(
        ConfigurationError, match=r"of FetchReach-v4 is missing .*base_link_collision.*--force-reinstall"
    ):
        make()


def test_the_originals_note_on_old_rewards_stays_silent(capfd):
    make_original("AdroitHandDoor-v1").close()
    assert capfd.readouterr().err == ""
