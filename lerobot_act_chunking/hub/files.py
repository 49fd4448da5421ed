"""Files of the local hub: received, hashed, linked, kept inside its folder."""

import contextlib
import hashlib
import os
import shutil
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from lerobot_act_chunking.durable_files import remove, scratch_path
from lerobot_act_chunking.hub.refusal import RefusedError

CHUNK = 1 << 20
"""How much of a file is read at a time [bytes]."""
BATCH = 1 << 20
"""How much of an incoming body is handed to the hashing thread at a time [bytes]."""


@dataclass(frozen=True)
class Received:
    """A body streamed to disk that waits to be published: where it is, its SHA-256, its size [bytes]."""

    path: Path
    digest: str
    size: int


@contextmanager
def received(chunks: Iterable[bytes], folder: Path) -> Iterator[Received]:
    """Stream ``chunks`` into a scratch file of ``folder``, hashing on the way, and force it to disk.

    Holds at most two batches in memory. The file disappears at the end unless it was published (moved away).
    """
    with scratch_path(folder) as path:
        # Plain open, not tempfile: its 0600 would ignore the umask that a shared folder relies on.
        with path.open("xb") as file:
            digest, size = _write_and_hash(chunks, file)
            file.flush()
            os.fsync(file.fileno())
        yield Received(path, digest, size)


def _write_and_hash(chunks: Iterable[bytes], file: BinaryIO) -> tuple[str, int]:
    """Write everything; return its SHA-256 [hex] and size [bytes]. Hashing runs beside the writing."""
    digest, size = hashlib.sha256(), 0
    with ThreadPoolExecutor(1) as hasher:
        hashed = hasher.submit(_update, digest, [])
        for batch in _batches(chunks):
            hashed.result()  # the hash may be one batch behind, not more
            hashed = hasher.submit(_update, digest, batch)
            for chunk in batch:
                file.write(chunk)
                size += len(chunk)
        hashed.result()
    return digest.hexdigest(), size


def _update(digest: "hashlib._Hash", batch: list[bytes]) -> None:
    for chunk in batch:
        digest.update(chunk)


def _batches(chunks: Iterable[bytes]) -> Iterator[list[bytes]]:
    batch, size = [], 0
    for chunk in chunks:
        batch.append(chunk)
        size += len(chunk)
        if size >= BATCH:
            yield batch
            batch, size = [], 0
    if batch:
        yield batch


def place(source: Path, target: Path, link: str) -> None:
    """Make ``target`` show ``source``: by the relative symlink ``link``, else a hard link, else a copy."""
    # A file system without links says so in many ways: EPERM, ENOTSUP, EINVAL, ...
    for make in (lambda: target.symlink_to(link), lambda: target.hardlink_to(source)):
        with contextlib.suppress(OSError, NotImplementedError):
            make()
            return
    with source.open("rb") as reader, target.open("xb") as writer:
        shutil.copyfileobj(reader, writer, CHUNK)
        writer.flush()
        os.fsync(writer.fileno())


def read_chunks(path: Path, start: int = 0) -> Iterator[bytes]:
    """A file's bytes from ``start`` on, a chunk at a time."""
    with path.open("rb") as file:
        file.seek(start)
        while chunk := file.read(CHUNK):
            yield chunk


def sha256_of(path: Path) -> str:
    """A file's SHA-256 [hex]."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def git_sha1_of(path: Path) -> str:
    """A file's git blob id [hex], the name huggingface_hub gives small files of the real Hub."""
    digest = hashlib.sha1(b"blob %d\0" % path.stat().st_size, usedforsecurity=False)
    for chunk in read_chunks(path):
        digest.update(chunk)
    return digest.hexdigest()


def is_inside(path: Path, folder: Path) -> bool:
    """Whether ``path``, with every symlink followed, stays in ``folder``."""
    return Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder))


def require_inside(path: Path, folder: Path) -> Path:
    """``path`` itself, refused if a symlink leads it out of ``folder``."""
    if not is_inside(path, folder):
        raise RefusedError(
            f"{path} leads out of {folder} through a symlink; replace the link by what it leads to",
            403,
        )
    return path


def remove_abandoned(folder: Path, older_than: float) -> None:
    """Remove what processes that died left half made in ``folder`` more than ``older_than`` [s] ago."""
    for path in folder.iterdir() if folder.is_dir() else ():
        with contextlib.suppress(OSError):  # somebody else's, or gone already
            if path.suffix != ".lock" and time.time() - path.stat().st_mtime > older_than:
                remove(path)


def remove_empty_parents(path: Path, folder: Path) -> None:
    """Remove the empty folders between ``path``, which is gone, and ``folder``."""
    with contextlib.suppress(OSError):  # not empty, or gone already
        for parent in path.parents:
            if parent == folder:
                return
            parent.rmdir()
