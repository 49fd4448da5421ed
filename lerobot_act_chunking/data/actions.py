"""The actions of a LeRobotDataset, read from its action column alone."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import torch
from jaxtyping import Float, Int64
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.utils.constants import ACTION
from torch import Tensor

from lerobot_act_chunking.data.dimension_names import dimension_names
from lerobot_act_chunking.data.missing_files import INFO
from lerobot_act_chunking.data.quiet import quiet_missing_ffmpeg
from lerobot_act_chunking.errors import DatasetError

KEPT_TO = 0.95  # of the episodes


@dataclass(frozen=True)
class Demonstrations:
    """The actions of a dataset.

    Attributes:
        folder: where it is.
        names: of the action dimensions.
        actions: raw actions of all episodes, one after the other.
        episode: index of the episode of each action.
        stats: the dataset's statistics.
        fps: control steps per second.
        features: all of the dataset's.
    """

    folder: Path
    names: tuple[str, ...]
    actions: Float[Tensor, "F A"]
    episode: Int64[np.ndarray, " F"]
    stats: dict[str, Any]
    fps: float
    features: dict[str, Any]


def is_dataset(folder: str | Path) -> bool:
    """Whether this is a LeRobotDataset's folder: one with ``meta/info.json``."""
    return (Path(folder) / INFO).is_file()


def require_dataset(folder: str | Path) -> None:
    """Refuse what is not a LeRobotDataset's folder.

    Raises:
        DatasetError: naming the folder, and what to give.
    """
    if not is_dataset(folder):
        raise DatasetError(f"there is no dataset at {folder}: give a LeRobotDataset's folder (with {INFO})")


def episode_starts(episode: np.ndarray) -> np.ndarray:
    """First row (E,) of each episode, from the episode's index (F,) of every row, 0 or more."""
    return np.flatnonzero(np.diff(episode, prepend=-1))


def read_demonstrations(folder: Path) -> Demonstrations:
    """Read a LeRobotDataset's actions; no image, video or state is touched.

    Raises:
        DatasetError: there is no dataset, it is damaged, or its actions are no vectors.
    """
    require_dataset(folder)
    quiet_missing_ffmpeg()
    try:
        meta = LeRobotDatasetMetadata(f"local/{folder.name}", root=folder)
        feature = meta.features[ACTION]
        (width,) = feature["shape"]
        tables = [
            pq.read_table(file, columns=[ACTION, "episode_index"])
            for file in sorted((folder / "data").rglob("*.parquet"))
        ]
        actions = np.concatenate([_rows(table[ACTION], width) for table in tables])
        episode = np.concatenate([table["episode_index"].to_numpy() for table in tables])
    except Exception as error:  # whatever LeRobot and its parsers raise on damaged files
        raise DatasetError(f"the actions of the dataset at {folder} cannot be read: {error!r}") from error
    names = dimension_names(feature)
    return Demonstrations(
        folder,
        names,
        torch.from_numpy(actions),
        episode.astype(np.int64),
        meta.stats or {},
        float(meta.fps),
        meta.features,
    )


def largest_changes(folder: Path, width: int) -> Float[np.ndarray, " A"]:
    """The largest change of each action dimension in one control step that 19 of 20 episodes keep to.

    A single slip of the hand, or one broken frame, then decides nothing; what every episode has, such as a
    gripper that snaps, does.

    Args:
        folder: of a LeRobotDataset.
        width: of its actions.

    Returns:
        Nothing where there is no episode of two frames, or no file (streaming).
    """
    largest = []
    for file in sorted((folder / "data").rglob("*.parquet")):
        table = pq.read_table(file, columns=[ACTION, "episode_index"])
        starts = episode_starts(table["episode_index"].to_numpy())
        episodes = np.split(_rows(table[ACTION], width), starts[1:])
        largest += [np.abs(np.diff(each, axis=0)).max(0) for each in episodes if len(each) > 1]
    return np.quantile(largest, KEPT_TO, axis=0) if largest else np.zeros(0)


def _rows(column: Any, width: int) -> Float[np.ndarray, "F A"]:
    # LeRobot stores vectors of one value as numbers, which have nothing to flatten.
    values = [chunk.flatten() if hasattr(chunk, "flatten") else chunk for chunk in column.chunks]
    flat = np.concatenate([each.to_numpy() for each in values])
    return flat.astype(np.float32).reshape(-1, width)
