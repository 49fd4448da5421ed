"""Wrapping a checkpoint from Python, and keeping the result."""

import os
from pathlib import Path
from typing import Any

from safetensors import SafetensorError

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.hub import files
from lerobot_act_chunking.policies.loading import LoadedPolicy


def load_wrapped(path: str | Path, **settings: Any) -> LoadedPolicy:
    """Load a checkpoint of any policy type with its processors, and execute its chunks as ``settings`` say.

    Args:
        path: checkpoint folder (``…/pretrained_model``) or repo id.
        settings: fields of `TemporalEnsembleConfig`, such as ``execution``, ``replan_interval``, ``device``.

    Raises:
        ConfigurationError: there is no such checkpoint, or it cannot be executed in this way.
    """
    from lerobot.policies.factory import make_pre_post_processors
    from lerobot.utils.import_utils import register_third_party_plugins

    from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
        TemporalEnsembleConfig,
    )
    from lerobot_act_chunking.policies.temporal_ensemble.modeling_temporal_ensemble import (
        TemporalEnsemblePolicy,
    )

    register_third_party_plugins()
    config = TemporalEnsembleConfig(inner_path=str(path), **{"push_to_hub": False, **settings})
    processors = make_pre_post_processors(config)
    return LoadedPolicy(TemporalEnsemblePolicy(config).eval(), *processors)


def save_checkpoint(loaded: LoadedPolicy, folder: Path) -> None:
    """Write a policy with its processors as a checkpoint: complete under its name, or not at all.

    Raises:
        ConfigurationError: ``folder`` exists, or the disk does not take it.
    """
    check_absent(folder)
    try:
        with files.scratch_path(folder.parent) as scratch:
            for part in loaded:
                part.save_pretrained(scratch)
            for file in scratch.iterdir():
                _sync(file)
            files.publish(scratch, folder)
    except (OSError, SafetensorError) as error:
        raise ConfigurationError(
            f"{folder} could not be written, and nothing of it was kept: {error}"
        ) from error


def check_absent(folder: Path) -> None:
    """Refuse to write over what exists.

    Raises:
        ConfigurationError: naming the folder.
    """
    if folder.exists() or folder.is_symlink():
        raise ConfigurationError(f"{folder} exists already: choose another folder, or remove it first")


def _sync(file: Path) -> None:
    with file.open("rb+") as opened:
        os.fsync(opened.fileno())
