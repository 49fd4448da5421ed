"""Single environments of any LeRobot environment, and what lies between them and a policy."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from lerobot.envs import utils
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env, make_env_pre_post_processors
from lerobot.utils.constants import ACTION

from lerobot_act_chunking.diagnostics.core.success_keys import IS_SUCCESS
from lerobot_act_chunking.errors import ActChunkingError, ConfigurationError

_THAW = getattr(utils, "NEW_ROLLOUT_OPTION", None)
"""The option that tells LeRobot's environments that an episode begins, where they ask for it."""


@dataclass(frozen=True)
class Worlds:
    """Environments that run together.

    Attributes:
        vector: that holds them; older Gymnasiums close them once it is gone.
        episode_length: control steps after which an episode is cut.
        reset_options: for ``reset``.
        before: the environment's own processor of observations, before the policy's.
        after: of actions (B, A), behind the policy's.
    """

    vector: Any
    episode_length: int
    reset_options: dict[str, Any] | None
    before: Callable[[dict[str, Any]], dict[str, Any]]
    after: Callable[[Any], Any]

    @property
    def envs(self) -> list[Any]:
        """Single environments."""
        return list(self.vector.envs)

    def close(self) -> None:
        """Close all environments."""
        self.vector.close()


def open_worlds(env_config: EnvConfig, n: int, policy_config: Any) -> Worlds:
    """Let LeRobot make ``n`` single environments, with their own processors.

    Raises:
        ConfigurationError: a suite of several tasks, or an environment that cannot be made here.
    """
    vector = _made_by_lerobot(env_config, n)
    before, after = make_env_pre_post_processors(
        env_config, getattr(policy_config, "inner_config", policy_config)
    )
    return Worlds(
        vector=vector,
        episode_length=episode_length(env_config, vector.envs[0]),
        reset_options=None if _THAW is None else {_THAW: True},
        before=before,
        after=lambda actions: after({ACTION: actions})[ACTION],
    )


def episode_length(env_config: EnvConfig, env: Any) -> int:
    """Control steps after which an episode of a single environment is cut.

    Raises:
        ConfigurationError: neither the environment nor its configuration knows.
    """
    length = getattr(env_config, "episode_length", None)
    if length:
        return length
    try:
        return env.get_wrapper_attr("_max_episode_steps")
    except AttributeError as error:
        raise ConfigurationError(
            f"the environment {env_config.type} does not say how long an episode is (_max_episode_steps): "
            "register it with gym.register(..., max_episode_steps=...)"
        ) from error


def _made_by_lerobot(env_config: EnvConfig, n: int) -> Any:
    try:
        suites = make_env(env_config, n_envs=n, use_async_envs=False)
    except ActChunkingError:
        raise
    except Exception as error:  # whatever simulators and their constructors raise
        raise ConfigurationError(
            f"LeRobot cannot make the environment {env_config.type} ({type(error).__name__}: {error}): "
            "install what it needs, or correct its --env options"
        ) from error
    tasks = {f"{suite} {task}": vector for suite, of in suites.items() for task, vector in of.items()}
    if len(tasks) != 1:
        for vector in tasks.values():
            vector.close()
        raise ConfigurationError(
            f"the environment {env_config.type} has {len(tasks)} tasks ({', '.join(tasks)}): choose one, as "
            "by --env.task=... or --env.task_ids=[0]"
        )
    (vector,) = tasks.values()
    return vector


def task_description(env: Any) -> str:
    """The instruction of an environment as ``lerobot-eval`` finds it; empty without one."""
    for name in ("task_description", "task"):
        with suppress(AttributeError):
            return env.get_wrapper_attr(name)
    return ""


def failure_of(env: Any) -> str | None:
    """How the present episode failed, from any environment with an attribute ``failure``.

    Returns:
        Its label; None where the episode has succeeded, or the environment cannot tell.
    """
    with suppress(AttributeError):
        return env.get_wrapper_attr("failure")
    return None


def succeeded(info: Mapping[str, Any], key: str = IS_SUCCESS) -> bool:
    """Whether a step's ``info`` says so; one without an answer says no."""
    return bool(said(info).get(key, False))


def mode_of(info: Mapping[str, Any]) -> int | None:
    """Which of several ways a step's ``info`` says the episode went; None where it says nothing of it."""
    mode = said(info).get("mode")
    return None if mode is None else int(mode)


def rules_of(info: Mapping[str, Any]) -> dict[str, bool]:
    """What a step's ``info`` says of every success rule: all its members with "success" in their names."""
    return {
        name: bool(value)
        for name, value in said(info).items()
        if "success" in name and isinstance(value, bool | int | float | np.bool_ | np.number)
    }


def said(info: Mapping[str, Any]) -> Mapping[str, Any]:
    """What counts of a step's ``info``: Gymnasium keeps that of an episode's end apart."""
    final = info.get("final_info")
    return final if isinstance(final, Mapping) else info
