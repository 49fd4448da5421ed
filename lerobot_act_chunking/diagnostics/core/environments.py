"""Which environment a policy acts in when a diagnosis lets it act."""

from collections.abc import Mapping
from typing import Any

from lerobot_act_chunking.diagnostics.core.compatibility import check_features, check_rate
from lerobot_act_chunking.diagnostics.core.training import read_training
from lerobot_act_chunking.envs.aloha.tasks import TASKS as ALOHA_TASKS
from lerobot_act_chunking.envs.configuration_envs import AlohaSimEnvConfig
from lerobot_act_chunking.envs.configuration_robotics import RoboticsEnvConfig
from lerobot_act_chunking.envs.configuration_three_gates import ThreeGatesEnvConfig
from lerobot_act_chunking.envs.robotics.tasks import TASKS as ROBOTICS_TASKS
from lerobot_act_chunking.errors import ConfigurationError, unknown_choice
from lerobot_act_chunking.policies.loading import LoadedPolicy

EnvironmentConfig = AlohaSimEnvConfig | RoboticsEnvConfig | ThreeGatesEnvConfig

TASKS: Mapping[str, type[EnvironmentConfig]] = {
    **dict.fromkeys(ALOHA_TASKS, AlohaSimEnvConfig),
    **dict.fromkeys(ROBOTICS_TASKS, RoboticsEnvConfig),
    "three_gates": ThreeGatesEnvConfig,
}
"""Every simulated task by its name, with the environment that has it."""

OTHER_ROBOT = (
    "run it on the robot or task that it was trained for (--task), or measure its recordings: act-chunking "
    "smoothness, resolution, codebook, latent and steps take a dataset's folder"
)


def check_task(task: str) -> None:
    """Refuse a task of no environment.

    Raises:
        ConfigurationError: no environment has it; lists those that there are.
    """
    if task not in TASKS:
        raise unknown_choice("task", task, TASKS)


def environment_of(
    policy: LoadedPolicy, checkpoint: str, *, task: str, success: str | None = None
) -> EnvironmentConfig:
    """The task's environment for a checkpoint, which must be one for this robot and its control rate.

    Args:
        policy: loaded from it.
        checkpoint: folder or repo id.
        task: one of ``TASKS``.
        success: as of `environment_for`.

    Raises:
        ConfigurationError: as `environment_for`.
        FeatureError: another robot's policy, or one for another control rate.
    """
    config = policy.policy.config
    env_config = environment_for(config, task=task, success=success)
    shapes = {env_config.features_map[key]: feature.shape for key, feature in env_config.features.items()}
    check_features(config, shapes, f"the task {task}", OTHER_ROBOT)
    check_rate(read_training(checkpoint, config).fps, env_config.fps, f"the task {task}", OTHER_ROBOT)
    return env_config


def environment_for(config: Any, *, task: str, success: str | None = None) -> EnvironmentConfig:
    """The configuration of the task's environment whose observations are the ones a policy was trained on.

    Args:
        config: the policy's.
        task: one of ``TASKS``.
        success: the environment's success rule; by default its own default.

    Raises:
        ConfigurationError: unknown task, rule or camera, cameras of different sizes, or cameras together with
            the state of the surroundings.
    """
    check_task(task)
    make = TASKS[task]
    options: dict[str, Any] = {"task": task, "render_quality": "fast"}
    if success is not None:
        options["success"] = success
    if make is RoboticsEnvConfig:
        options["velocities"] = _sees_velocities(config.input_features, task)
    images = config.image_features
    if not images:
        if make is not RoboticsEnvConfig:
            options["agent_vel"] = "observation.agent_vel" in config.input_features
        return make(**options, obs_type="state")
    sizes = {tuple(feature.shape[-2:]) for feature in images.values()}
    if len(sizes) > 1:
        raise ConfigurationError(f"an environment renders one image size, the policy wants {sorted(sizes)}")
    height, width = sizes.pop()
    return make(
        **options,
        obs_type="pixels_state" if "observation.state" in config.input_features else "pixels",
        cameras=[key.removeprefix("observation.images.") for key in images],
        observation_height=height,
        observation_width=width,
    )


def _sees_velocities(features: Mapping[str, Any], task: str) -> bool:
    complete = ROBOTICS_TASKS[task]
    sizes = {
        "observation.state": len(complete.state_names),
        "observation.environment_state": len(complete.environment_names),
    }
    return all(features[key].shape == (size,) for key, size in sizes.items() if key in features)
