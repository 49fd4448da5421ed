"""The hub as a folder in huggingface_hub's own cache layout.

::

    DIR/models--org--name/blobs/<sha-256>            file contents
                          snapshots/<commit>/<path>  symlinks to blobs, else hard links, else copies
                          refs/<branch or tag>       a commit id
                          .hub/commits/<commit>.json what the revision contains and where it came from
                          .hub/tags/<tag>            marks a ref as a tag
                          .hub/incoming/             bodies being received, snapshots being built
    DIR/.locks/lerobot-hub/                          a lock per repository; half-created repositories

An unmodified huggingface_hub reads the first three with ``HF_HUB_CACHE=DIR HF_HUB_OFFLINE=1`` and ignores the
rest (``.locks`` is the one folder beside repositories that its scanner skips).
"""

import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from lerobot_act_chunking import durable_files
from lerobot_act_chunking.hub import files
from lerobot_act_chunking.hub.commits import current_user
from lerobot_act_chunking.hub.names import RepoName
from lerobot_act_chunking.hub.refusal import RefusedError, conflict, repo_not_found
from lerobot_act_chunking.hub.repository import Repository

LOCK_TIMEOUT = 600.0
"""How long a writer waits for the one before it [s]; a publication itself takes milliseconds."""


class LocalHub:
    """Every repository below one folder."""

    def __init__(self, root: str | os.PathLike[str]):
        # abspath, not resolve: messages name the folder as the user does.
        self.root = Path(os.path.abspath(Path(root).expanduser()))  # noqa: PTH100

    def names(self) -> list[RepoName]:
        """What is called like a repository, damaged or not, but for folders closed to the user."""
        if not self.root.is_dir():
            return []
        found = ((RepoName.from_folder(path.name), path) for path in self.root.iterdir())
        return sorted(name for name, path in found if name is not None and not _closed(path))

    def holds(self, name: RepoName) -> bool:
        """Whether the repository exists here."""
        return (self.root / name.folder).is_dir()

    def full_name(self, name: RepoName) -> RepoName:
        """The name with its owner: the current user where it was left out, as the real Hub does it."""
        if "/" in name.repo_id or self.holds(name):
            return name
        return RepoName.checked(name.kind, f"{owner_name()}/{name.repo_id}")

    def open(self, name: RepoName) -> Repository:
        """The repository.

        Raises:
            RefusedError: it does not exist, or a symlink leads it out of the hub.
        """
        folder = self.root / name.folder
        if not self.holds(name):
            if os.path.lexists(folder):
                raise RefusedError(f"{folder} is no folder; move it out of the hub", 422)
            raise repo_not_found(name.repo_id, self.root)
        return Repository(name, self.root)

    def create(self, name: RepoName, *, private: bool = False) -> Repository:
        """A new repository with one empty revision on ``main``; private means readable by its owner only."""
        self._work_folder.mkdir(parents=True, exist_ok=True)
        with self.lock(name):
            if os.path.lexists(self.root / name.folder):
                raise conflict(f"{name.repo_id!r} is already in the local hub {self.root}")
            name.creatable()
            with durable_files.scratch_path(self._work_folder) as scratch:
                scratch.mkdir()
                if private:
                    set_private(scratch, private)
                Repository.initialise(scratch)
                durable_files.publish(scratch, self.root / name.folder)
        return self.open(name)

    def delete(self, name: RepoName) -> None:
        """Remove a repository. Readers see all of it or nothing of it."""
        repository = self.open(name)
        with self.lock(name), durable_files.scratch_path(self._work_folder) as trash:
            durable_files.publish(repository.folder, trash)
        files.remove_abandoned(self._work_folder, LOCK_TIMEOUT)

    @contextmanager
    def lock(self, name: RepoName) -> Iterator[None]:
        """One writer at a time, across threads, processes and machines that share the folder."""
        path = self._work_folder / f"{name.folder}.lock"
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            # 0666: whoever may write to the folder may lock it.
            with FileLock(path, timeout=LOCK_TIMEOUT, mode=0o666):
                yield
        except Timeout as error:
            raise RefusedError(
                f"another push to {name.repo_id!r} has held {path} for {LOCK_TIMEOUT:.0f} s", 423
            ) from error

    @property
    def _work_folder(self) -> Path:
        return self.root / ".locks" / "lerobot-hub"


def _closed(folder: Path) -> bool:
    """Whether it is somebody's private repository."""
    return folder.is_dir() and not os.access(folder, os.X_OK)


def owner_name() -> str:
    """The current user's name, reduced to what a repository id may contain."""
    return re.sub(r"[^A-Za-z0-9]+", "-", current_user()).strip("-")[:96].strip("-") or "local"


def set_private(folder: Path, private: bool) -> None:
    """Close a repository's folder to everybody but its owner, or open it as far as the hub itself is open."""
    special = stat.S_IMODE(folder.stat().st_mode) & ~0o777  # a shared folder's set-group-id bit stays
    folder.chmod(special | (0o700 if private else stat.S_IMODE(folder.parent.stat().st_mode) & 0o777))
    if private and not is_private(folder):
        raise RefusedError(
            f"the file system of {folder.parent} cannot keep a repository private; choose another folder"
        )


def is_private(folder: Path) -> bool:
    """Whether only the owner may look into the folder."""
    return stat.S_IMODE(folder.stat().st_mode) & 0o077 == 0
