"""The original environment of gymnasium-robotics behind a task."""

from contextlib import redirect_stderr
from io import StringIO
from typing import Any

import gymnasium as gym

from lerobot_act_chunking.errors import ConfigurationError

INSTALL = "pip install 'gymnasium-robotics>=1.4,<2'"


def make_original(task: str) -> Any:
    """gymnasium-robotics' environment with the Gymnasium id ``task``, bare: no time limit, no checks.

    Raises:
        ConfigurationError: gymnasium-robotics, the task or one of its files is not installed.
    """
    _register()
    try:
        return gym.make(task, max_episode_steps=-1, disable_env_checker=True).unwrapped
    except gym.error.Error as error:
        raise ConfigurationError(f"this gymnasium-robotics has no {task} ({error}): {INSTALL}") from error
    except (OSError, ValueError) as error:  # MuJoCo's for a mesh or texture that is not there
        raise ConfigurationError(
            f"a model file of {task} is missing or damaged ({error}): {INSTALL} --force-reinstall"
        ) from error


def _register() -> None:
    # Its import registers the ids, and prints a note on the dense rewards of Adroit in release 1.2 at every
    # command and in every worker; docs/robotics.md says it once.
    try:
        with redirect_stderr(StringIO()):
            import gymnasium_robotics  # noqa: F401
    except ImportError as error:
        raise ConfigurationError(
            f"the {error.name or 'gymnasium_robotics'} package is missing: {INSTALL}"
        ) from error
