from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from headless import run_headless
from stock import smooth_actions

from lerobot_act_chunking.envs.aloha.env import AlohaSimEnv
from lerobot_act_chunking.envs.aloha.experts import ExpertOptions, plan
from lerobot_act_chunking.errors import ConfigurationError, FeatureError

GYM_IDS = ("aloha_sim/TransferCube-v0", "aloha_sim/Insertion-v0", "aloha_sim/TransferModes-v0")
SMALL = {"observation_height": 48, "observation_width": 64, "render_quality": "fast"}
POSE = np.array([0.15, 0.45, 0.05, 1.0, 0.0, 0.0, 0.0])


@pytest.fixture
def make():
    """Make environments that are closed after the test."""
    made = []

    def build(**options):
        made.append(AlohaSimEnv(**options))
        return made[-1]

    yield build
    for env in made:
        env.close()


def rollout(env, seed, steps=30):
    observation, _ = env.reset(seed=seed)
    observations = [observation["agent_pos"]]
    for action in smooth_actions(observation["agent_pos"], steps, np.random.default_rng(seed)):
        observations.append(env.step(action)[0]["agent_pos"])
    return np.stack(observations)


# Gymnasium would like actions in -1 .. 1; ALOHA's are absolute radians.
@pytest.mark.filterwarnings("ignore:.*symmetric and normalized space:UserWarning")
@pytest.mark.parametrize("gym_id", GYM_IDS)
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"obs_type": "pixels", "cameras": ["angle", "left_wrist"], **SMALL},
        {"obs_type": "pixels_state", "agent_vel": True, **SMALL},
    ],
)
def test_gymnasiums_checker_passes(gym_id, options):
    env = gym.make(gym_id, visualization_height=48, visualization_width=64, **options)
    check_env(env.unwrapped)
    assert env.get_wrapper_attr("_max_episode_steps") == 400
    env.close()


@pytest.mark.parametrize(
    ("options", "keys"),
    [
        ({}, {"agent_pos", "environment_state"}),
        ({"agent_vel": True}, {"agent_pos", "agent_vel", "environment_state"}),
        ({"obs_type": "pixels", **SMALL}, {"pixels"}),
        ({"obs_type": "pixels_state", **SMALL}, {"agent_pos", "pixels"}),
        ({"obs_type": "pixels_state", "agent_vel": True, **SMALL}, {"agent_pos", "agent_vel", "pixels"}),
    ],
)
def test_observation_keys(make, options, keys):
    env = make(**options)
    observation, _ = env.reset(seed=0)
    assert set(observation) == keys
    assert env.observation_space.contains(observation)


def test_observations_are_the_worlds(make):
    env = make(task="insertion", agent_vel=True)
    env.reset(seed=3)
    observation = env.step(env.world.qpos() + 0.05)[0]
    assert np.array_equal(observation["agent_pos"], env.world.qpos())
    assert np.array_equal(observation["agent_vel"], env.world.qvel())
    assert np.array_equal(observation["environment_state"], env.world.environment_state())
    assert observation["environment_state"].shape == (14,)


def test_only_the_cameras_asked_for(make):
    env = make(obs_type="pixels", cameras=["right_wrist", "top"], observation_height=30, observation_width=50)
    pixels = env.reset(seed=0)[0]["pixels"]
    assert {name: image.shape for name, image in pixels.items()} == {
        "right_wrist": (30, 50, 3),
        "top": (30, 50, 3),
    }


def test_same_seed_same_episode(make):
    env = make(task="insertion")
    assert np.array_equal(rollout(env, seed=4), rollout(make(task="insertion"), seed=4))
    assert np.array_equal(rollout(env, seed=4), rollout(env, seed=4))


def test_unseeded_resets_continue_a_seeded_sequence(make):
    def poses(env):
        env.reset(seed=8)
        return [env.reset()[0]["environment_state"] for _ in range(3)]

    first, second = poses(make()), poses(make())
    assert np.array_equal(first, second)
    assert len({tuple(pose) for pose in first}) == 3


def test_object_pose_option(make):
    env = make()
    observation, _ = env.reset(seed=1, options={"object_pose": POSE, "lerobot_new_rollout": True})
    assert np.array_equal(observation["environment_state"], POSE)
    with pytest.raises(ConfigurationError, match=r"has shape \(7,\)"):
        env.reset(options={"object_pose": POSE[:3]})


def test_episodes_end_at_success_as_gym_aloha_does(make):
    env = make(success="touch")
    assert run_expert(env) == {"is_success": True, "success_touch": True, "success_hold": False}


def test_hold_ends_later_and_means_more(make):
    env = make(success="hold")
    assert run_expert(env) == {"is_success": True, "success_touch": True, "success_hold": True}
    assert env.reset(seed=1)[1] == {"is_success": False, "success_touch": False, "success_hold": False}


def run_expert(env):
    """The info of the step that terminated; the reward there must be gym-aloha's 4."""
    _, info = env.reset(seed=5)
    expert = plan(env.task, env.world.environment_state(), ExpertOptions(), np.random.default_rng(0))
    for action in expert.commands:
        _, reward, terminated, truncated, info = env.step(action)
        assert terminated is info["is_success"]
        assert not truncated
        if terminated:
            assert reward == 4.0
            break
    return info


def test_render_shows_the_top_camera_at_its_own_size(make):
    env = make(obs_type="pixels", visualization_height=40, visualization_width=80, **SMALL)
    env.reset(seed=0)
    assert env.render().shape == (40, 80, 3)
    assert env.metadata["render_fps"] == 50
    assert make(render_mode=None).render() is None


def test_words_for_language_policies(make):
    assert make(task="insertion").task_description == "Insert the peg into the socket."
    assert make(task="transfer_cube").task == "transfer_cube"


def test_refusals(make):
    with pytest.raises(
        ConfigurationError, match="unknown render_mode 'human'; choose one of: rgb_array, None"
    ):
        make(render_mode="human")
    with pytest.raises(ConfigurationError, match="unknown camera 'side'"):
        gym.make(GYM_IDS[0], obs_type="pixels", cameras=["side"])
    with pytest.raises(FeatureError, match=r"shape \(14,\)"):
        make().step(np.zeros((1, 14)))


def test_action_space_holds_expert_actions(make):
    env = make()
    env.reset(seed=2)
    expert = plan(env.task, env.world.environment_state(), ExpertOptions(), np.random.default_rng(0))
    assert all(env.action_space.contains(action.astype(np.float32)) for action in expert.actions)


@pytest.mark.parametrize("vector", [gym.vector.SyncVectorEnv, gym.vector.AsyncVectorEnv])
def test_vector_environments_are_independent(vector, make):
    build = partial(gym.make, f"lerobot_act_chunking:{GYM_IDS[0]}", obs_type="pixels_state", **SMALL)
    extra = {"context": "forkserver"} if vector is gym.vector.AsyncVectorEnv else {}
    envs = vector([build] * 2, autoreset_mode=gym.vector.AutoresetMode.SAME_STEP, **extra)
    try:
        observation, info = envs.reset(seed=[6, 7])
        assert info["is_success"].tolist() == [False, False]
        actions = np.stack(
            [pos + shift for pos, shift in zip(observation["agent_pos"], (0.1, -0.1), strict=True)]
        )
        observation = envs.step(actions)[0]
        for index, seed in enumerate((6, 7)):
            alone = make(obs_type="pixels_state", **SMALL)
            alone.reset(seed=seed)
            expected = alone.step(actions[index])[0]
            assert np.array_equal(observation["agent_pos"][index], expected["agent_pos"])
            assert np.array_equal(observation["pixels"]["top"][index], expected["pixels"]["top"])
        assert len(envs.call("render")) == 2
    finally:
        envs.close()


def test_state_only_never_touches_opengl():
    program = """
import sys
import gymnasium as gym, mujoco
import lerobot_act_chunking

def refuse(*_, **__):
    raise AssertionError("OpenGL was asked for")

mujoco.MjrContext = mujoco.GLContext = refuse
env = gym.make("aloha_sim/Insertion-v0")
observation, _ = env.reset(seed=0)
env.step(observation["agent_pos"])
env.close()
assert "OpenGL" not in sys.modules and "mujoco.egl" not in sys.modules
"""
    assert run_headless(program).stderr == ""
