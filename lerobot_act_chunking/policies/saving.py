"""Checkpoints written whole, or not at all."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from safetensors import SafetensorError

from lerobot_act_chunking import durable_files
from lerobot_act_chunking.errors import ConfigurationError


def save_checkpoint(parts: Iterable[Any], folder: Path) -> None:
    """Write a policy with its processors as a checkpoint: complete under its name, or not at all.

    Args:
        parts: such as a `LoadedPolicy`; whatever has LeRobot's ``save_pretrained``.
        folder: to make.

    Raises:
        ConfigurationError: ``folder`` exists, or the disk does not take it.
    """
    check_absent(folder)
    try:
        with durable_files.scratch_path(folder.parent) as scratch:
            for part in parts:
                part.save_pretrained(scratch)
            durable_files.sync_tree(scratch)
            durable_files.publish(scratch, folder)
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
