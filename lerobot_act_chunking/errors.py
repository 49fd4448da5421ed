"""The package's errors: each message names the offending value and the way out."""

import importlib
from collections.abc import Iterable, Mapping
from typing import Any


class ActChunkingError(Exception):
    """Root of every error this package raises on purpose; the command line prints it without a traceback."""


class ConfigurationError(ActChunkingError):
    """A setting that cannot work, found before anything expensive starts.

    Not a ValueError: LeRobot's command line swallows the messages of those ("Couldn't instantiate class").
    """


class FeatureError(ActChunkingError, KeyError):
    """An observation, action or camera that is missing, unknown or of the wrong shape."""

    def __str__(self) -> str:
        # KeyError would print the message as a quoted repr.
        return str(self.args[0]) if self.args else ""


class DatasetError(ActChunkingError):
    """A dataset that is absent, damaged, or not what the command expected."""


class WorkerError(ActChunkingError):
    """Work that was given up because the processes that did it died."""


def unknown_choice(what: str, value: object, choices: Iterable[str]) -> ConfigurationError:
    """The error for a name outside its allowed set, with the set spelled out."""
    return ConfigurationError(f"unknown {what} {value!r}; choose one of: {', '.join(choices)}")


def look_up[T](what: str, name: str, table: Mapping[str, T]) -> T:
    """The entry of this name.

    Raises:
        ConfigurationError: there is none; it lists the names.
    """
    if name not in table:
        raise unknown_choice(what, name, table)
    return table[name]


def need(module: str, asked: str, requirement: str) -> Any:
    """Import a part of the installation that may be missing.

    Args:
        module: to import.
        asked: the setting that needs it, as ``vision_backbone=efficientnet_lite0``.
        requirement: what pip installs it by.

    Raises:
        ConfigurationError: with the command that installs it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ConfigurationError(
            f"{asked} needs {error.name or module}: pip install '{requirement}'"
        ) from error
