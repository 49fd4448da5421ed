"""A full disk, explained."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lerobot_act_chunking.durable_files import DISK_FULL
from lerobot_act_chunking.errors import DatasetError


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
    if isinstance(error, OSError) and error.errno in DISK_FULL:
        return True
    # LeRobot's encoder threads pass on the text alone.
    return any(os.strerror(code) in str(error) for code in DISK_FULL)
