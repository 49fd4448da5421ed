"""The package's errors: each message names the offending value and the way out."""

from act_chunking_runtime.errors import (
    ActChunkingError,
    ConfigurationError,
    FeatureError,
    look_up,
    need,
    unknown_choice,
)

__all__ = [
    "ActChunkingError",
    "ConfigurationError",
    "DatasetError",
    "FeatureError",
    "WorkerError",
    "look_up",
    "need",
    "unknown_choice",
]


class DatasetError(ActChunkingError):
    """A dataset that is absent, damaged, or not what the command expected."""


class WorkerError(ActChunkingError):
    """Work that was given up because the processes that did it died."""
