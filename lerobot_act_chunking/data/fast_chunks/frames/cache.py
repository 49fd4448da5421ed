"""Where frames are kept, how much of them, and what has to go.

``ACT_CHUNKING_FRAME_CACHE`` names the folder, by default ``frame_cache`` in LeRobot's (``HF_LEROBOT_HOME``);
``0`` turns the cache off. ``ACT_CHUNKING_FRAME_CACHE_GB`` is the most that it may hold [GB], by default 32.
"""

import hashlib
import json
import logging
import os
import shutil
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock
from lerobot.datasets.dataset_reader import DatasetReader
from lerobot.utils.constants import HF_LEROBOT_HOME

from lerobot_act_chunking.data.fast_chunks.frames.store import DESCRIPTION, FrameStore, frame_shape
from lerobot_act_chunking.durable_files import remove
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.image_view import Size

FOLDER, LIMIT = "ACT_CHUNKING_FRAME_CACHE", "ACT_CHUNKING_FRAME_CACHE_GB"
DEFAULT_LIMIT_GB = 32.0
LEFT_FREE = 5 * 10**9  # bytes of the disk, for everything else
VERSION = 1  # of what is stored

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Wanted:
    """The store that a camera's frames belong into.

    Attributes:
        store: its files may not exist yet.
        content: what its frames were made from; frames of anything else are in another store.
    """

    store: FrameStore
    content: dict[str, Any]


def open_stores(
    reader: DatasetReader, cameras: Collection[str], size: Size | None, n_frames: int
) -> dict[str, FrameStore]:
    """A store for each of these cameras; none at all if the cache is off or there is no room for them.

    Args:
        reader: LeRobot's, of the dataset.
        cameras: keys of its videos.
        size: (height, width) that frames are resized to; None to leave them as they are.
        n_frames: that will be read of each camera.
    """
    root = cache_folder()
    if root is None or not cameras:
        return {}
    wanted = {key: _wanted(root, reader, key, size) for key in cameras}
    try:
        root.mkdir(parents=True, exist_ok=True)
        with FileLock(root / ".lock"):
            reason = _make_room(root, wanted, n_frames)
            if reason is None:
                for each in wanted.values():
                    each.store.prepare(each.content)
                return {key: each.store for key, each in wanted.items()}
    except OSError as error:
        reason = str(error)
    logger.warning("frames are decoded each time, without a cache: %s", reason)
    return {}


def cache_folder() -> Path | None:
    """The folder that the environment names, or LeRobot's; None if the cache is off."""
    named = os.environ.get(FOLDER)
    if named == "0":
        return None
    return Path(named).expanduser() if named else HF_LEROBOT_HOME / "frame_cache"


def _wanted(root: Path, reader: DatasetReader, key: str, size: Size | None) -> Wanted:
    meta: Any = reader._meta
    shape = frame_shape(meta.features[key]["shape"], size)
    content = {"dataset": meta.repo_id, **_origin(reader, key), "shape": list(shape), "version": VERSION}
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
    name = f"{meta.repo_id}.{key}.{shape[1]}x{shape[2]}.{digest}".replace("/", "_")
    return Wanted(FrameStore(root / name, shape, meta.total_frames), content)


def _origin(reader: DatasetReader, key: str) -> dict[str, Any]:
    """What a camera's frames follow from: its files, which frame is where in them, and who decodes them."""
    meta: Any = reader._meta
    folder = Path(reader.root)
    files = {folder / meta.get_video_file_path(episode, key) for episode in range(meta.total_episodes)}
    states = [(str(file.relative_to(folder)), file.stat()) for file in sorted(files) if file.exists()]
    columns = ("dataset_from_index", "dataset_to_index", f"videos/{key}/from_timestamp")
    places = np.stack([np.asarray(meta.episodes[name][:], np.float64) for name in columns])
    return {
        "camera": key,
        "files": [[name, state.st_size, state.st_mtime_ns] for name, state in states],
        "codec": (meta.features[key].get("info") or {}).get("video.codec"),
        "fps": meta.fps,
        "places": hashlib.sha256(places.tobytes()).hexdigest(),
        "decoder": reader._video_backend,
    }


def _make_room(root: Path, wanted: Mapping[str, Wanted], n_frames: int) -> str | None:
    """Delete what has not been used for longest until all stores fit; or say why they cannot."""
    ours = {each.store.folder for each in wanted.values()}
    needed = sum(n_frames * each.store.frame_bytes for each in wanted.values())
    limit = _limit()
    if needed > limit:
        return (
            f"they would take {needed / 1e9:.1f} GB, more than {LIMIT}={limit / 1e9:g}; smaller ones take "
            "less (--policy.resize_shape='[240, 320]')"
        )
    others = sorted(
        (each.parent for each in root.glob(f"*/{DESCRIPTION}") if each.parent not in ours), key=_last_used
    )
    present = sum(map(_bytes_on_disk, ours))
    kept = sum(map(_bytes_on_disk, others))
    for folder in others:
        if kept + needed <= limit and _free(root) + present - needed >= LEFT_FREE:
            break
        kept -= _bytes_on_disk(folder)
        remove(folder)
    free = _free(root) + present
    if free - needed < LEFT_FREE:
        return (
            f"they would take {needed / 1e9:.1f} GB of the {free / 1e9:.1f} GB on the disk of {root}, where "
            f"{LEFT_FREE / 1e9:g} GB are left to others; {FOLDER} names another folder"
        )
    return None


def _limit() -> float:
    """The most that all stores may take together [bytes]."""
    given = os.environ.get(LIMIT) or str(DEFAULT_LIMIT_GB)
    try:
        return float(given) * 1e9
    except ValueError as error:
        raise ConfigurationError(f"{LIMIT}={given} must be a number of gigabytes, such as 32") from error


def _free(root: Path) -> int:
    return shutil.disk_usage(root).free


def _last_used(folder: Path) -> float:
    return (folder / DESCRIPTION).stat().st_mtime


def _bytes_on_disk(folder: Path) -> int:
    """What a folder takes, without the holes of its files."""
    files = folder.iterdir() if folder.is_dir() else ()
    return sum(512 * getattr(state, "st_blocks", -(-state.st_size // 512)) for state in map(Path.stat, files))
