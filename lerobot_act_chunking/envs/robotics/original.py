"""The original environment of gymnasium-robotics behind a task."""

from contextlib import redirect_stderr
from io import StringIO
from typing import Any

import gymnasium as gym

from lerobot_act_chunking.errors import ConfigurationError, need

REQUIREMENT = "gymnasium-robotics>=1.4,<2"
INSTALL = f"pip install '{REQUIREMENT}'"


def make_original(task: str) -> Any:
    """gymnasium-robotics' environment with the Gymnasium id ``task``, bare: no time limit, no checks.

    Raises:
        ConfigurationError: gymnasium-robotics, the task or one of its files is not installed.
    """
    _register(task)
    try:
        return gym.make(task, max_episode_steps=-1, disable_env_checker=True).unwrapped
    except gym.error.Error as error:
        raise ConfigurationError(f"this gymnasium-robotics has no {task} ({error}): {INSTALL}") from error
    except (OSError, ValueError) as error:  # MuJoCo's for a mesh or texture that is not there
        raise ConfigurationError(
            f"a model file of {task} is missing or damaged ({error}): {INSTALL} --force-reinstall"
        ) from error


def _register(task: str) -> None:
    # Its import registers the ids, and prints a note on the dense rewards of Adroit in release 1.2 at every
    # command and in every worker; docs/guides/robotics.md says it once.
    with redirect_stderr(StringIO()):
        need("gymnasium_robotics", task, REQUIREMENT)
