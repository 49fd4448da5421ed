"""`--env.type=gymnasium_robotics` as LeRobot's commands use it."""

import json
from dataclasses import dataclass

import draccus
import gymnasium as gym
import numpy as np
import pytest
from lerobot.configs import FeatureType
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env
from lerobot.envs.utils import check_env_attributes_and_types, env_to_policy_features, preprocess_observation

from lerobot_act_chunking.envs.configuration_robotics import RoboticsEnvConfig
from lerobot_act_chunking.envs.robotics.env import RoboticsEnv
from lerobot_act_chunking.errors import ConfigurationError

SMALL = {"observation_height": 48, "observation_width": 64, "render_quality": "fast"}


@dataclass
class Command:
    """Stands for lerobot-eval's configuration."""

    env: EnvConfig


def parse(*arguments):
    return draccus.parse(Command, args=["--env.type=gymnasium_robotics", *arguments]).env


def first_observation(config):
    """The first observation of one environment, as policies get it."""
    vector = make_env(config, n_envs=1)["gymnasium_robotics"][0]
    try:
        return preprocess_observation(vector.reset(seed=[0])[0])
    finally:
        vector.close()


def test_command_line():
    config = parse(
        "--env.task=FetchPush-v4",
        "--env.obs_type=pixels_state",
        '--env.cameras=["view","gripper_camera_rgb"]',
        "--env.observation_height=96",
        "--env.render_quality=fast",
        "--env.velocities=false",
        "--env.success=final",
        "--env.episode_length=80",
    )
    assert (config.gym_id, config.fps) == ("gymnasium_robotics/FetchPush-v4", 25)
    assert config.gym_kwargs == {
        "task": "FetchPush-v4",
        "obs_type": "pixels_state",
        "cameras": ["view", "gripper_camera_rgb"],
        "observation_height": 96,
        "observation_width": 640,
        "render_quality": "fast",
        "velocities": False,
        "success": "final",
        "visualization_height": 480,
        "visualization_width": 640,
        "episode_length": 80,
    }


def test_survives_a_train_config_on_disk():
    config = parse("--env.task=AdroitHandDoor-v1", '--env.cameras=["fixed"]', "--env.obs_type=pixels")
    stored = json.dumps(draccus.encode(config))
    assert draccus.decode(EnvConfig, {**json.loads(stored), "type": "gymnasium_robotics"}) == config
    assert config.fps == 100


@pytest.mark.parametrize(
    ("options", "features"),
    [
        ({}, {"observation.state": (10,), "observation.environment_state": (3,)}),
        (
            {"task": "FetchPickAndPlace-v4"},
            {"observation.state": (10,), "observation.environment_state": (18,)},
        ),
        (
            {"task": "FrankaKitchen-v1"},
            {"observation.state": (18,), "observation.environment_state": (58,)},
        ),
        (
            {"obs_type": "pixels", "cameras": ["external_camera_0"], **SMALL},
            {"observation.images.external_camera_0": (3, 48, 64)},
        ),
        (
            {"task": "AdroitHandPen-v1", "obs_type": "pixels_state", "cameras": ["view", "fixed"], **SMALL},
            {
                "observation.state": (24,),
                "observation.images.view": (3, 48, 64),
                "observation.images.fixed": (3, 48, 64),
            },
        ),
    ],
)
def test_policy_features_are_what_environments_deliver(options, features):
    config = RoboticsEnvConfig(**options)
    policy_features = env_to_policy_features(config)
    assert policy_features.pop("action").type is FeatureType.ACTION
    assert {key: feature.shape for key, feature in policy_features.items()} == features
    delivered = first_observation(config)
    assert {key: tuple(value.shape[1:]) for key, value in delivered.items()} == features


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"task": "FetchPush-v1"},
            "unknown gymnasium_robotics task 'FetchPush-v1'; choose one of: FetchReach-v4",
        ),
        ({"cameras": ["top"]}, "unknown camera 'top'; choose one of: view, head_camera_rgb"),
        ({"success": "hold"}, "unknown success rule 'hold'; choose one of: any, final"),
        ({"fps": 50}, "FetchReach-v4 runs at 25 control steps a second, got fps=50"),
        ({"episode_length": -1}, "episode_length is a number of steps, or 0 for the original's, got -1"),
        ({"task": "HandReach-v3", "cameras": ["fixed"]}, "unknown camera 'fixed'; choose one of: view$"),
    ],
)
def test_refused_before_anything_starts(options, message):
    with pytest.raises(ConfigurationError, match=message):
        RoboticsEnvConfig(**options)


def test_an_unknown_task_on_the_command_line_lists_the_tasks():
    with pytest.raises(draccus.utils.ParsingError) as refused:
        parse("--env.task=PointMaze_UMaze-v3")
    message = str(refused.value.__cause__)
    assert "unknown gymnasium_robotics task 'PointMaze_UMaze-v3'; choose one of: FetchReach-v4" in message
    assert "FrankaKitchen-v1" in message


def check_rollout(vector):
    """What lerobot-eval does with a vector environment whose episodes are three steps long."""
    check_env_attributes_and_types(vector)
    observation, info = vector.reset(seed=[4, 5], options={"lerobot_new_rollout": True})
    assert info["is_success"].tolist() == [False, False]
    assert list(vector.call("_max_episode_steps")) == [3, 3]
    assert set(vector.call("task_description")) == {"Push the block to the target."}
    assert vector.call("render")[1].shape == (24, 32, 3)
    alone = RoboticsEnv(task="FetchPush-v4")
    assert np.array_equal(observation["environment_state"][1], alone.reset(seed=5)[0]["environment_state"])
    for left in (2, 1, 0):
        observation, reward, terminated, truncated, info = vector.step(np.full((2, 4), 0.3, np.float32))
        if left:  # at the end, the observation is the next episode's first
            expected = alone.step(np.full(4, 0.3, np.float32))[0]
            assert np.array_equal(observation["agent_pos"][1], expected["agent_pos"])
    assert truncated.tolist() == [True, True]
    assert info["final_info"]["is_success"].tolist() == terminated.tolist() == [False, False]
    assert reward.tolist() == [-1, -1]


@pytest.mark.parametrize(
    "use_async", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["sync", "async"]
)
def test_vector_environments_serve_lerobot_eval(use_async):
    config = RoboticsEnvConfig(
        task="FetchPush-v4",
        episode_length=3,
        render_quality="fast",
        visualization_height=24,
        visualization_width=32,
    )
    vector = make_env(config, n_envs=2, use_async_envs=use_async)["gymnasium_robotics"][0]
    assert isinstance(vector, gym.vector.AsyncVectorEnv if use_async else gym.vector.SyncVectorEnv)
    try:
        check_rollout(vector)
    finally:
        vector.close()
