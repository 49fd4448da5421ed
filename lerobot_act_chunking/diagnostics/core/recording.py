"""Everything of a dataset but its pictures, episode by episode."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_act_chunking.data.actions import episode_starts
from lerobot_act_chunking.data.dimension_names import dimension_names
from lerobot_act_chunking.data.quiet import quiet_missing_ffmpeg
from lerobot_act_chunking.errors import DatasetError

EPISODE = "episode_index"
TIME = "time"
"""Columns with one number and this in their name are clocks."""


@dataclass(frozen=True)
class Episode:
    """One demonstration of L frames.

    Attributes:
        index: LeRobot's.
        action: (L, A) in raw units.
        state: (L, S); S is 0 where nothing is observed.
        clocks: (L,) by column: times as they were written, in any unit.
    """

    index: int
    action: np.ndarray
    state: np.ndarray
    clocks: dict[str, np.ndarray] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.action)

    @property
    def broken(self) -> list[str]:
        """Columns that hold a NaN or an infinity."""
        columns = {ACTION: self.action, OBS_STATE: self.state}
        return [key for key, rows in columns.items() if not np.isfinite(rows).all()]


@dataclass(frozen=True)
class Recording:
    """A dataset.

    Attributes:
        folder: where it lies.
        fps: frames per second, as it says.
        action_names: of the A dimensions.
        state_names: of the S dimensions.
        episodes: in their order.
        operators: who demonstrates, by episode; empty where nobody is named.
    """

    folder: str
    fps: float
    action_names: Sequence[str]
    state_names: Sequence[str]
    episodes: tuple[Episode, ...]
    operators: dict[int, str] = field(default_factory=dict)

    @property
    def frames(self) -> int:
        """Of all episodes."""
        return sum(map(len, self.episodes))

    @property
    def actions(self) -> list[np.ndarray]:
        """(L, A) of each episode."""
        return [each.action for each in self.episodes]

    @property
    def states(self) -> list[np.ndarray]:
        """(L, S) of each episode."""
        return [each.state for each in self.episodes]


def read_metadata(folder: str) -> LeRobotDatasetMetadata:
    """What a dataset says of itself.

    Raises:
        DatasetError: it is damaged, or has no vectors of actions.
    """
    quiet_missing_ffmpeg()
    try:
        meta = LeRobotDatasetMetadata(f"local/{Path(folder).name}", root=folder)
    except Exception as error:  # whatever LeRobot and its parsers raise on damaged files
        raise DatasetError(f"the dataset at {folder} cannot be read: {error!r}") from error
    if ACTION not in meta.features:
        raise DatasetError(
            f"the dataset at {folder} has no {ACTION!r}; it has {', '.join(meta.features)}: rename the one "
            "that holds the actions"
        )
    if len(meta.features[ACTION]["shape"]) != 1 or not meta.fps > 0:
        raise DatasetError(
            f"{folder}/meta/info.json says fps={meta.fps} and actions of shape "
            f"{tuple(meta.features[ACTION]['shape'])}: it takes a rate above 0, and vectors"
        )
    return meta


def read_recording(meta: LeRobotDatasetMetadata, operators: dict[int, str]) -> Recording:
    """Read the numbers of a dataset; nothing is decoded.

    Raises:
        DatasetError: it is damaged or empty.
    """
    features = meta.features
    state = OBS_STATE if OBS_STATE in features and len(features[OBS_STATE]["shape"]) == 1 else None
    clocks = [key for key, each in features.items() if TIME in key and tuple(each["shape"]) == (1,)]
    try:
        table = read_columns(meta, [EPISODE, ACTION, *filter(None, [state]), *clocks])
        starts = episode_starts(table[EPISODE].to_numpy())
        episodes = _episodes(table, features, state, clocks, starts)
    except Exception as error:  # whatever PyArrow raises on damaged files
        raise DatasetError(f"the numbers of the dataset at {meta.root} cannot be read: {error!r}") from error
    if not episodes:
        raise DatasetError(f"the dataset at {meta.root} holds no episodes: record some")
    return Recording(
        folder=str(meta.root),
        fps=float(meta.fps),
        action_names=dimension_names(features[ACTION]),
        state_names=dimension_names(features[state]) if state else (),
        episodes=episodes,
        operators=operators,
    )


def read_columns(meta: LeRobotDatasetMetadata, columns: Sequence[str]) -> pa.Table:
    """Columns of all data files, in the order of the frames."""
    files = sorted((Path(meta.root) / "data").rglob("*.parquet"))
    return pa.concat_tables([pq.read_table(file, columns=list(columns)) for file in files])


def _episodes(
    table: pa.Table,
    features: dict[str, Any],
    state: str | None,
    clocks: Sequence[str],
    starts: np.ndarray,
) -> tuple[Episode, ...]:
    actions = _rows(table[ACTION], features[ACTION]["shape"][0])
    states = _rows(table[state], features[state]["shape"][0]) if state else np.empty((len(actions), 0))
    times = {key: _column(table[key]) for key in clocks}
    index = table[EPISODE].to_numpy()
    ends = [*starts[1:], len(actions)]
    return tuple(
        Episode(
            int(index[first]),
            actions[first:last],
            states[first:last],
            {key: each[first:last] for key, each in times.items()},
        )
        for first, last in zip(starts, ends, strict=True)
    )


def _rows(column: Any, width: int) -> np.ndarray:
    flat = np.concatenate([chunk.flatten().to_numpy(zero_copy_only=False) for chunk in column.chunks])
    return flat.astype(np.float64).reshape(-1, width)


def _column(column: Any) -> np.ndarray:
    """Single numbers, which LeRobot writes bare or as lists of one."""
    nested = pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type)
    chunks = [chunk.flatten() if nested else chunk for chunk in column.chunks]
    return np.concatenate([chunk.to_numpy(zero_copy_only=False) for chunk in chunks])
