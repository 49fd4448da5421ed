"""``--env.type=so_arm_sim``: LeRobot's command line, features and evaluation."""

import json
from dataclasses import dataclass
from types import SimpleNamespace

import draccus
import numpy as np
import pytest
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env
from lerobot.envs.utils import check_env_attributes_and_types, env_to_policy_features, preprocess_observation

from lerobot_act_chunking.diagnostics.core.environments import environment_of, task_environment
from lerobot_act_chunking.envs.configuration_so_arm import SoArmSimEnvConfig
from lerobot_act_chunking.errors import ConfigurationError

SMALL = {"observation_height": 24, "observation_width": 32, "render_quality": "fast"}


@dataclass
class Command:
    """Stands for lerobot-eval's configuration."""

    env: EnvConfig


def test_command_line_and_disk():
    words = ["--env.type=so_arm_sim", "--env.task=stack", "--env.backlash=0.5", "--env.cameras=[wrist]"]
    config = draccus.parse(Command, args=words).env
    assert (config.gym_id, config.fps) == ("so_arm_sim/Stack-v0", 30)
    assert config.gym_kwargs["backlash"] == 0.5
    assert config.gym_kwargs["cameras"] == ["wrist"]
    stored = json.dumps(draccus.encode(config))
    assert draccus.decode(EnvConfig, {**json.loads(stored), "type": "so_arm_sim"}) == config


@pytest.mark.parametrize(
    ("options", "features"),
    [
        ({"task": "two_ways"}, {"observation.state": (6,), "observation.environment_state": (11,)}),
        (
            {"obs_type": "pixels_state", **SMALL},
            {
                "observation.state": (6,),
                "observation.images.front": (3, 24, 32),
                "observation.images.wrist": (3, 24, 32),
            },
        ),
    ],
    ids=str,
)
def test_policy_features_are_what_environments_deliver(options, features):
    config = SoArmSimEnvConfig(**options)
    policy_features = env_to_policy_features(config)
    assert policy_features.pop("action").shape == (6,)
    assert {key: feature.shape for key, feature in policy_features.items()} == features
    vector = make_env(config, n_envs=1)["so_arm_sim"][0]
    delivered = preprocess_observation(vector.reset(seed=[0])[0])
    vector.close()
    assert {key: tuple(value.shape[1:]) for key, value in delivered.items()} == features


@pytest.mark.parametrize("task", ["pick_place", "stack", "two_ways"])
def test_instruments_find_the_task(task):
    seen = env_to_policy_features(SoArmSimEnvConfig(task=task))
    action = seen.pop("action")
    policy = SimpleNamespace(image_features={}, input_features=seen, action_feature=action, fps=30)
    config = environment_of(policy, task_environment(task))
    assert isinstance(config, SoArmSimEnvConfig)
    assert config.task == task
    assert config.action_names[-1] == "gripper.pos"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fps": 50}, "so_arm_sim runs at 30 control steps a second, got fps=50"),
        ({"episode_length": 0}, "episode_length is at least one step, got 0"),
    ],
)
def test_refused_before_anything_starts(options, message):
    with pytest.raises(ConfigurationError, match=message):
        SoArmSimEnvConfig(**options)


def test_vector_environments_serve_lerobot_eval():
    config = SoArmSimEnvConfig(
        episode_length=2,
        task="two_ways",
        render_quality="fast",
        visualization_height=24,
        visualization_width=32,
    )
    vector = make_env(config, n_envs=2)["so_arm_sim"][0]
    try:
        check_env_attributes_and_types(vector)
        vector.reset(seed=[4, 5])
        assert set(vector.call("task_description")) == {"Put the cube into either box."}
        assert vector.call("render")[1].shape == (24, 32, 3)
        for _ in range(2):
            _, _, _, truncated, info = vector.step(np.zeros((2, 6), np.float32))
        assert truncated.tolist() == [True, True]
        assert info["final_info"]["mode"].tolist() == [-1, -1]
    finally:
        vector.close()
