"""Writes that a crash cannot tear: complete or absent, and on the disk when they return."""

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from lerobot_act_chunking.errors import DatasetError

_FULL = (errno.ENOSPC, errno.EDQUOT)


def write_atomically(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Let ``write`` fill a hidden neighbour of ``path``, then put it in place in one step.

    A crash before that leaves at most the neighbour, ``.<name>.<pid>``.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with temporary.open("wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync(path.parent)


def sync(path: Path) -> None:
    """Wait until a file, or a folder's list of names, is on the disk."""
    if os.name == "nt" and path.is_dir():  # Windows cannot open folders
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sync_tree(folder: Path) -> None:
    """Wait until a folder with all it holds is on the disk."""
    for path in folder.rglob("*"):
        sync(path)
    sync(folder)


@contextmanager
def explain_full_disk(kept: Path) -> Iterator[None]:
    """Turn "no space left", from whichever writer it comes, into an error that says what is safe.

    Raises:
        DatasetError: the disk or the quota is full.
    """
    try:
        yield
    except (OSError, RuntimeError) as error:
        if not _is_full_disk(error):
            raise
        raise DatasetError(
            f"the disk is full ({error}); every finished episode is safe in {kept}: "
            "free some space and run the same command again"
        ) from error


def _is_full_disk(error: Exception) -> bool:
    if isinstance(error, OSError) and error.errno in _FULL:
        return True
    # LeRobot's encoder threads pass on the text alone.
    return any(os.strerror(code) in str(error) for code in _FULL)
