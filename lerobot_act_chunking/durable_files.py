"""Durable writes: what is visible under its final name is complete, also after a power cut."""

import errno
import os
import shutil
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

DISK_FULL = (errno.ENOSPC, errno.EDQUOT)
_NO_FOLDER_SYNC = (errno.EINVAL, errno.EACCES, errno.ENOTSUP, errno.EBADF)


def write_atomically(path: Path, content: bytes, scratch: Path | None = None) -> None:
    """Write a file so that readers see the old content or the new, never a mixture.

    Args:
        path: of the file; its folder is made if need be.
        content: the new content.
        scratch: where the file is written first, on the same disk; by default beside ``path``.
    """
    fill_atomically(path, lambda file: file.write(content), scratch)


def fill_atomically(path: Path, write: Callable[[BinaryIO], object], scratch: Path | None = None) -> None:
    """As `write_atomically`, for content that ``write`` puts into a file."""
    with scratch_path(path.parent if scratch is None else scratch) as part:
        # Plain open, not tempfile: its 0600 would ignore the umask that a shared folder relies on.
        with part.open("xb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        publish(part, path)


@contextmanager
def scratch_path(folder: Path) -> Iterator[Path]:
    """A fresh path in ``folder`` for a file or tree under construction; removed if it was not moved away."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f".{uuid.uuid4().hex}"
    try:
        yield path
    finally:
        remove(path)


def publish(source: Path, target: Path) -> None:
    """Give a finished file or folder its final name, atomically, replacing an existing file."""
    target.parent.mkdir(parents=True, exist_ok=True)
    source.replace(target)
    sync_folder(target.parent)


def sync_tree(folder: Path) -> None:
    """Wait until a folder with all it holds is on the disk."""
    for path in folder.rglob("*"):
        if path.is_dir():
            sync_folder(path)
        else:
            _sync_file(path)
    sync_folder(folder)


def sync_folder(folder: Path) -> None:
    """Make renames inside ``folder`` survive a power cut, where the file system can promise that."""
    if os.name == "nt":  # Windows has no handle to sync a folder with
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _NO_FOLDER_SYNC:
            raise
    finally:
        os.close(descriptor)


def _sync_file(path: Path) -> None:
    with path.open("rb+" if os.name == "nt" else "rb") as file:  # Windows syncs what may be written
        os.fsync(file.fileno())


def remove(path: Path) -> None:
    """Delete a file or a tree; nothing happens if it is gone already."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
