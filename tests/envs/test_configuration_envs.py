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

from lerobot_act_chunking.envs.configuration_envs import AlohaSimEnvConfig
from lerobot_act_chunking.errors import ConfigurationError

SMALL = {"observation_height": 48, "observation_width": 64, "render_quality": "fast"}


@dataclass
class Command:
    """Stands for lerobot-eval's configuration."""

    env: EnvConfig


def parse(*arguments):
    return draccus.parse(Command, args=["--env.type=aloha_sim", *arguments]).env


def first_observation(config):
    """The first observation of one environment, as policies get it."""
    vector = make_env(config, n_envs=1)["aloha_sim"][0]
    try:
        return preprocess_observation(vector.reset(seed=[0])[0])
    finally:
        vector.close()


def test_command_line():
    config = parse(
        "--env.task=insertion",
        "--env.obs_type=pixels_state",
        '--env.cameras=["top","angle"]',
        "--env.observation_height=96",
        "--env.render_quality=fast",
        "--env.success=hold",
        "--env.episode_length=500",
    )
    assert config.gym_id == "aloha_sim/Insertion-v0"
    assert config.cameras == ["top", "angle"]
    assert config.gym_kwargs == {
        "task": "insertion",
        "obs_type": "pixels_state",
        "cameras": ["top", "angle"],
        "observation_height": 96,
        "observation_width": 640,
        "render_quality": "fast",
        "success": "hold",
        "agent_vel": False,
        "instructions": "seen",
        "visualization_height": 480,
        "visualization_width": 640,
        "max_episode_steps": 500,
    }


def test_defaults_are_the_state_of_the_cube_task():
    config = parse()
    assert (config.gym_id, config.obs_type, config.fps) == ("aloha_sim/TransferCube-v0", "state", 50)


def test_survives_a_train_config_on_disk():
    config = parse("--env.task=insertion", '--env.cameras=["angle"]', "--env.obs_type=pixels")
    stored = json.dumps(draccus.encode(config))
    assert draccus.decode(EnvConfig, {**json.loads(stored), "type": "aloha_sim"}) == config


@pytest.mark.parametrize(
    ("options", "features"),
    [
        (
            {"task": "insertion", "agent_vel": True},
            {
                "observation.state": (14,),
                "observation.agent_vel": (14,),
                "observation.environment_state": (14,),
            },
        ),
        ({}, {"observation.state": (14,), "observation.environment_state": (7,)}),
        ({"obs_type": "pixels", "cameras": ["angle"], **SMALL}, {"observation.images.angle": (3, 48, 64)}),
        (
            {"obs_type": "pixels_state", "cameras": ["top", "left_wrist"], **SMALL},
            {
                "observation.state": (14,),
                "observation.images.top": (3, 48, 64),
                "observation.images.left_wrist": (3, 48, 64),
            },
        ),
    ],
)
def test_policy_features_are_what_environments_deliver(options, features):
    config = AlohaSimEnvConfig(**options)
    policy_features = env_to_policy_features(config)
    assert policy_features.pop("action").shape == (14,)
    assert {key: feature.shape for key, feature in policy_features.items()} == features
    delivered = first_observation(config)
    assert {key: tuple(value.shape[1:]) for key, value in delivered.items()} == features


def test_images_are_named_as_in_datasets():
    # lerobot-eval --eval.recording=true makes these the dataset's columns and finds the images by them.
    config = AlohaSimEnvConfig(obs_type="pixels_state", cameras=["top", "angle"])
    images = {"observation.images.top", "observation.images.angle"}
    assert set(config.features) == {"action", "agent_pos"} | images


def test_feature_types():
    config = AlohaSimEnvConfig(agent_vel=True)
    types = {key: feature.type for key, feature in env_to_policy_features(config).items()}
    assert types == {
        "action": FeatureType.ACTION,
        "observation.state": FeatureType.STATE,
        "observation.agent_vel": FeatureType.STATE,
        "observation.environment_state": FeatureType.ENV,
    }


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": "pour"}, "unknown task 'pour'; choose one of: transfer_cube, insertion"),
        ({"cameras": ["side"]}, "unknown camera 'side'; choose one of: top, angle"),
        ({"observation_height": 0}, "observation_height is a whole number of pixels"),
        ({"success": "grab"}, "unknown success rule 'grab'"),
        ({"fps": 30}, "aloha_sim runs at 50 control steps a second, got fps=30"),
        ({"episode_length": 0}, "episode_length is at least one step, got 0"),
    ],
)
def test_refused_before_anything_starts(options, message):
    with pytest.raises(ConfigurationError, match=message):
        AlohaSimEnvConfig(**options)


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("--env.task=pour", "unknown task 'pour'; choose one of: transfer_cube, insertion"),
        ("--env.obs_type=image", "unknown obs_type 'image'; choose one of: state, pixels, pixels_state"),
        ("--env.success=grab", "unknown success rule 'grab'; choose one of: touch, hold"),
        ('--env.cameras=["side"]', "unknown camera 'side'; choose one of: top, angle"),
    ],
)
def test_unknown_names_on_the_command_line(argument, message):
    with pytest.raises(draccus.utils.ParsingError) as refused:
        parse(argument)
    assert message in str(refused.value.__cause__)


def test_environments_of_other_types_keep_their_own_values():
    # One command line serves all types: a Literal of ours would refuse what LeRobot's types accept.
    arguments = ["--env.type=aloha", "--env.task=AlohaInsertion-v0", "--env.obs_type=pixels_agent_pos"]
    stock = draccus.parse(Command, args=arguments).env
    assert (stock.task, stock.obs_type) == ("AlohaInsertion-v0", "pixels_agent_pos")


def check_rollout(vector):
    """What lerobot-eval does with a vector environment."""
    check_env_attributes_and_types(vector)
    vector.reset(seed=[4, 5], options={"lerobot_new_rollout": True})
    assert list(vector.call("_max_episode_steps")) == [3, 3]
    assert len(set(vector.call("task_description"))) == 1
    assert vector.unwrapped.metadata["render_fps"] == 50
    assert vector.call("render")[1].shape == (24, 32, 3)
    for _ in range(3):
        _, reward, terminated, truncated, info = vector.step(np.zeros((2, 14), np.float32))
    assert truncated.tolist() == [True, True]
    assert info["final_info"]["is_success"].tolist() == terminated.tolist() == [False, False]
    assert reward.shape == (2,)


@pytest.mark.parametrize(
    "use_async", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["sync", "async"]
)
def test_vector_environments_serve_lerobot_eval(use_async):
    config = AlohaSimEnvConfig(
        episode_length=3, render_quality="fast", visualization_height=24, visualization_width=32
    )
    vector = make_env(config, n_envs=2, use_async_envs=use_async)["aloha_sim"][0]
    assert isinstance(vector, gym.vector.AsyncVectorEnv if use_async else gym.vector.SyncVectorEnv)
    try:
        check_rollout(vector)
    finally:
        vector.close()
