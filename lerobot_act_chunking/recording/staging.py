"""Where a recording lives until it is complete: a hidden folder beside the dataset's.

    .<name>.recording/
      manifest.json             what the episodes depend on; a resumed recording must agree
      lock                      held by the one recorder at work
      episodes/seed-*.npz       one file per finished attempt, written in one step
      dataset/                  the LeRobotDataset being put together; renamed to <name> when complete

Nothing appears under the dataset's own name before it is complete; what is complete survives any crash.
"""

import json
import shutil
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout

from lerobot_act_chunking.durable_files import fill_atomically, publish, sync_tree, write_atomically
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.json_files import read_json
from lerobot_act_chunking.recording.episode import Episode
from lerobot_act_chunking.recording.lossless import LosslessVideo

_TORN = (zipfile.BadZipFile, EOFError, ValueError, KeyError)


class EpisodeStore:
    """Finished attempts, one file each; successes with their frames, failures with their outcome only."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def save(self, episode: Episode) -> None:
        """Keep an attempt; on return it is safe from any crash."""
        header: dict[str, Any] = {"success": episode.success, "details": episode.details, "videos": {}}
        if episode.task is not None:
            header["task"] = episode.task
        entries: dict[str, Any] = {}
        if episode.success:
            entries |= {f"array/{name}": array for name, array in episode.arrays.items()}
            for name, video in episode.videos.items():
                header["videos"][name] = [video.length, video.height, video.width]
                entries[f"video/{name}"] = np.frombuffer(video.data, np.uint8)
        entries["header"] = np.array(json.dumps(header))
        fill_atomically(self._path(episode.seed), lambda file: np.savez(file, **entries))

    def load(self, seed: int) -> Episode:
        """The attempt of ``seed`` as it was saved."""
        with self._path(seed).open("rb") as handle, np.load(handle) as file:
            header = json.loads(str(file["header"]))
            arrays = {name[6:]: file[name] for name in file.files if name.startswith("array/")}
            videos = {
                name: LosslessVideo(file[f"video/{name}"].tobytes(), *size)
                for name, size in header["videos"].items()
            }
        task = header.get("task")
        return Episode(seed, header["success"], arrays, videos, header["details"], task)

    def outcomes(self) -> dict[int, bool]:
        """{seed: success} of every attempt in store; damaged files are dropped, to be recorded again."""
        found = {}
        for path in sorted(self.folder.iterdir()):
            seed = int(path.stem.removeprefix("seed-")) if path.suffix == ".npz" else None
            try:
                if seed is not None:
                    found[seed] = self.load(seed).success
                    continue
            except _TORN:
                pass
            path.unlink(missing_ok=True)
        return found

    def _path(self, seed: int) -> Path:
        return self.folder / f"seed-{seed:010d}.npz"


class Staging:
    """The hidden folder of one recording, open; see the module's picture."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.folder = staging_folder(root)
        self.store = EpisodeStore(self.folder / "episodes")
        self.dataset = self.folder / "dataset"

    def publish(self) -> None:
        """Give the complete dataset its name, in one step, and drop the staging folder."""
        sync_tree(self.dataset)
        if self.root.exists():
            self.root.rmdir()  # empty, or the recording would have been refused
        publish(self.dataset, self.root)
        shutil.rmtree(self.folder, ignore_errors=True)


def staging_folder(root: Path) -> Path:
    """Where the recording of ``root`` is staged."""
    return root.parent / f".{root.name}.recording"


@contextmanager
def open_staging(root: Path, manifest: dict[str, Any]) -> Iterator[Staging]:
    """Begin or resume the recording of ``root``.

    Args:
        root: the dataset's folder, which does not hold anything yet.
        manifest: what the episodes depend on, as JSON.

    Raises:
        ConfigurationError: the folder cannot be written, another recorder is at work, or the episodes staged
            so far were made with another manifest.
    """
    staging = Staging(root)
    try:
        staging.folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(staging.folder / "lock")
        lock.acquire(blocking=False)
    except Timeout:
        raise ConfigurationError(f"another recorder is at work on {root}; wait for it or stop it") from None
    except OSError as error:
        raise ConfigurationError(
            f"cannot write to {root.parent} ({error.strerror}); choose another root"
        ) from error
    try:
        _agree(staging.folder, manifest)
        staging.store.folder.mkdir(exist_ok=True)
        shutil.rmtree(staging.dataset, ignore_errors=True)  # what a killed recorder was putting together
        yield staging
    finally:
        with suppress(OSError):  # published: the lock's file is gone
            lock.release()


def _agree(folder: Path, manifest: dict[str, Any]) -> None:
    path = folder / "manifest.json"
    if not path.exists():
        write_atomically(path, json.dumps(manifest, indent=2).encode())
        return
    try:
        different = differences(read_json(path), manifest)
    except (ValueError, TypeError, AttributeError) as error:
        raise ConfigurationError(
            f"{path} is damaged ({error}): with the settings of the unfinished recording, remove that file "
            "and repeat the command to go on; otherwise choose another root"
        ) from error
    if different:
        raise ConfigurationError(
            f"{folder} holds an unfinished recording with other settings ({different}); "
            "run it again with those, delete that folder, or choose another root"
        )


def differences(kept: dict[str, Any], requested: dict[str, Any]) -> str:
    """Which settings differ, for an error message; empty when none does."""
    requested = json.loads(json.dumps(requested))
    names = [name for name in {**kept, **requested} if kept.get(name) != requested.get(name)]
    return ", ".join(f"{name}: {kept.get(name)}, asked for {requested.get(name)}" for name in names)
