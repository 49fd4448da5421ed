"""Single environments of any LeRobot environment, and what lies between them and a policy."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import draccus
import gymnasium as gym
import numpy as np
from draccus.utils import DraccusException
from lerobot.envs import utils
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env, make_env_pre_post_processors
from lerobot.envs.utils import env_to_policy_features
from lerobot.utils.constants import ACTION
from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_act_chunking.diagnostics.core.compatibility import check_features
from lerobot_act_chunking.diagnostics.core.environments import OTHER_ROBOT, EnvironmentConfig
from lerobot_act_chunking.errors import ConfigurationError, unknown_choice

_THAW = getattr(utils, "NEW_ROLLOUT_OPTION", None)
"""The option that tells LeRobot's environments that an episode begins, where they ask for it."""


@dataclass(frozen=True)
class Worlds:
    """Environments that run together.

    Attributes:
        envs: single environments.
        episode_length: control steps after which an episode is cut.
        reset_options: for ``reset``.
        before: the environment's own processor of observations, before the policy's.
        after: of actions (B, A), behind the policy's.
    """

    envs: list[Any]
    episode_length: int
    reset_options: dict[str, Any] | None = None
    before: Callable[[dict[str, Any]], dict[str, Any]] = lambda observation: observation
    after: Callable[[Any], Any] = lambda actions: actions

    def close(self) -> None:
        """Close all environments."""
        for env in self.envs:
            env.close()


def open_worlds(env_config: EnvConfig, n: int, policy_config: Any) -> Worlds:
    """Make ``n`` single environments.

    Those of this package come bare; all others are made by LeRobot, with their own processors.

    Raises:
        ConfigurationError: a suite of several tasks, or an environment that cannot be made here.
    """
    if isinstance(env_config, EnvironmentConfig):
        make = (env_config.gym_id, env_config.gym_kwargs)
        envs = [gym.make(make[0], disable_env_checker=True, **make[1]).unwrapped for _ in range(n)]
        return Worlds(envs, env_config.episode_length)
    envs = _made_by_lerobot(env_config, n)
    length = getattr(env_config, "episode_length", None) or envs[0].get_wrapper_attr("_max_episode_steps")
    before, after = make_env_pre_post_processors(
        env_config, getattr(policy_config, "inner_config", policy_config)
    )
    return Worlds(
        envs=envs,
        episode_length=length,
        reset_options=None if _THAW is None else {_THAW: True},
        before=before,
        after=lambda actions: after({ACTION: actions})[ACTION],
    )


def _made_by_lerobot(env_config: EnvConfig, n: int) -> list[Any]:
    try:
        suites = make_env(env_config, n_envs=n, use_async_envs=False)
    except (ImportError, RuntimeError, ValueError, gym.error.Error) as error:
        raise ConfigurationError(
            f"LeRobot cannot make the environment {env_config.type}: {error}; install what it needs, or "
            "correct its --env-arg"
        ) from error
    tasks = {f"{suite} {task}": vector for suite, of in suites.items() for task, vector in of.items()}
    if len(tasks) != 1:
        for vector in tasks.values():
            vector.close()
        raise ConfigurationError(
            f"the environment {env_config.type} has {len(tasks)} tasks ({', '.join(tasks)}): choose one with "
            "--env-arg, as in task=... or task_ids=[0]"
        )
    (vector,) = tasks.values()
    return list(vector.envs)  # pyright: ignore[reportAttributeAccessIssue]  (a SyncVectorEnv)


def task_description(env: Any) -> str:
    """The instruction of an environment as ``lerobot-eval`` finds it; empty without one."""
    for name in ("task_description", "task"):
        with suppress(AttributeError):
            return env.get_wrapper_attr(name)
    return ""


def succeeded(info: Mapping[str, Any]) -> bool:
    """Whether a step's ``info`` says so; one without an answer says no."""
    final = info.get("final_info")
    return bool((final if isinstance(final, Mapping) else info).get("is_success", False))


def failure_of(env: Any) -> str | None:
    """What went wrong in the present episode, of an environment with an attribute ``failure``."""
    with suppress(AttributeError):
        return env.get_wrapper_attr("failure")
    return None


def rules_of(info: Mapping[str, Any]) -> dict[str, bool]:
    """What a step's ``info`` says of every success rule: all its members with "success" in their names."""
    final = info.get("final_info")
    said = final if isinstance(final, Mapping) else info
    return {
        name: bool(value)
        for name, value in said.items()
        if "success" in name and isinstance(value, bool | int | float | np.bool_ | np.number)
    }


def make_env_config(env_type: str, arguments: Mapping[str, Any]) -> EnvConfig:
    """The configuration of any environment that LeRobot or a plug-in knows, as ``--env.type`` makes it.

    Args:
        env_type: its name.
        arguments: fields of its configuration.

    Raises:
        ConfigurationError: an unknown name, or arguments that it does not take.
    """
    register_third_party_plugins()
    types = EnvConfig.get_known_choices()
    if env_type not in types:
        raise unknown_choice("environment type", env_type, sorted(types))
    try:
        return draccus.decode(EnvConfig.get_choice_class(env_type), dict(arguments))
    except DraccusException as error:
        raise ConfigurationError(
            f"--env-arg of the environment {env_type}: {error}; give fields of its configuration"
        ) from error


def check_sees_what_it_needs(config: Any, env_config: EnvConfig) -> None:
    """Refuse an environment whose observations or actions are not the policy's, as far as can be told.

    An environment with processors of its own may rename what it observes: there the policy finds out.

    Raises:
        FeatureError: naming the key and both sizes.
    """
    if any(pipeline.steps for pipeline in env_config.get_env_processors()):
        return
    shapes = {key: feature.shape for key, feature in env_to_policy_features(env_config).items()}
    check_features(config, shapes, f"the environment {env_config.type}", OTHER_ROBOT)
