"""``--env.type=three_gates``: LeRobot's command line, features and evaluation."""

import json
from dataclasses import dataclass
from types import SimpleNamespace

import draccus
import gymnasium as gym
import numpy as np
import pytest
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env
from lerobot.envs.utils import check_env_attributes_and_types, env_to_policy_features, preprocess_observation

from lerobot_act_chunking.diagnostics.core.environments import environment_of, task_environment
from lerobot_act_chunking.envs.configuration_three_gates import ThreeGatesEnvConfig
from lerobot_act_chunking.errors import ConfigurationError

SMALL = {"observation_height": 24, "observation_width": 32, "render_quality": "fast"}


@dataclass
class Command:
    """Stands for lerobot-eval's configuration."""

    env: EnvConfig


def parse(*arguments):
    return draccus.parse(Command, args=["--env.type=three_gates", *arguments]).env


def test_command_line_and_disk():
    config = parse("--env.obs_type=pixels_state", "--env.episode_length=25", "--env.agent_vel=true")
    assert (config.gym_id, config.fps) == ("three_gates/ThreeGates-v0", 10)
    assert config.gym_kwargs["max_episode_steps"] == 25
    assert config.gym_kwargs["obs_type"] == "pixels_state"
    assert config.gym_kwargs["agent_vel"]
    stored = json.dumps(draccus.encode(config))
    assert draccus.decode(EnvConfig, {**json.loads(stored), "type": "three_gates"}) == config


@pytest.mark.parametrize(
    ("options", "features"),
    [
        ({}, {"observation.state": (2,), "observation.environment_state": (6,)}),
        (
            {"agent_vel": True},
            {
                "observation.state": (2,),
                "observation.agent_vel": (2,),
                "observation.environment_state": (6,),
            },
        ),
        (
            {"obs_type": "pixels_state", **SMALL},
            {"observation.state": (2,), "observation.images.top": (3, 24, 32)},
        ),
        ({"obs_type": "pixels", **SMALL}, {"observation.images.top": (3, 24, 32)}),
    ],
    ids=str,
)
def test_policy_features_are_what_environments_deliver(options, features):
    config = ThreeGatesEnvConfig(**options)
    policy_features = env_to_policy_features(config)
    assert policy_features.pop("action").shape == (2,)
    assert {key: feature.shape for key, feature in policy_features.items()} == features
    vector = make_env(config, n_envs=1)["three_gates"][0]
    delivered = preprocess_observation(vector.reset(seed=[0])[0])
    vector.close()
    assert {key: tuple(value.shape[1:]) for key, value in delivered.items()} == features


@pytest.mark.parametrize("agent_vel", [False, True])
def test_instruments_find_the_task_and_show_a_policy_what_it_saw(agent_vel):
    seen = env_to_policy_features(ThreeGatesEnvConfig(agent_vel=agent_vel))
    action = seen.pop("action")
    policy = SimpleNamespace(image_features={}, input_features=seen, action_feature=action, fps=10)
    config = environment_of(policy, task_environment("three_gates"))
    assert isinstance(config, ThreeGatesEnvConfig)
    assert config.agent_vel is agent_vel


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": "four_gates"}, "unknown task 'four_gates'; choose one of: three_gates"),
        ({"fps": 50}, "three_gates runs at 10 control steps a second, got fps=50"),
        ({"episode_length": 0}, "episode_length is at least one step, got 0"),
    ],
)
def test_refused_before_anything_starts(options, message):
    with pytest.raises(ConfigurationError, match=message):
        ThreeGatesEnvConfig(**options)


def test_vector_environments_serve_lerobot_eval():
    config = ThreeGatesEnvConfig(
        episode_length=3, render_quality="fast", visualization_height=24, visualization_width=32
    )
    vector = make_env(config, n_envs=2)["three_gates"][0]
    assert isinstance(vector, gym.vector.SyncVectorEnv)
    try:
        check_env_attributes_and_types(vector)
        vector.reset(seed=[4, 5])
        assert list(vector.call("_max_episode_steps")) == [3, 3]
        assert set(vector.call("task_description")) == {"Leave the ring through any gate."}
        assert vector.unwrapped.metadata["render_fps"] == 10
        assert vector.call("render")[1].shape == (24, 32, 3)
        for _ in range(3):
            _, _, _, truncated, info = vector.step(np.zeros((2, 2), np.float32))
        assert truncated.tolist() == [True, True]
        assert info["final_info"]["is_success"].tolist() == [False, False]
        assert info["final_info"]["mode"].tolist() == [-1, -1]
    finally:
        vector.close()
