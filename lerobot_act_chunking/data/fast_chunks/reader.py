"""LeRobot's items, gathered from columnar memory."""

import copy
from collections.abc import Callable, Collection, Mapping
from typing import Any

import datasets
import numpy as np
import torch
from jaxtyping import Int64
from lerobot.datasets.dataset_reader import DatasetReader
from torch import Tensor

from lerobot_act_chunking.data.fast_chunks.batch import GatheredBatch, Item
from lerobot_act_chunking.data.fast_chunks.columns import Column, has_gaps, numeric_columns
from lerobot_act_chunking.data.fast_chunks.frames.source import Frames, Moments
from lerobot_act_chunking.data.fast_chunks.windows import EpisodeWindows


class ChunkReader:
    """Builds the items of a LeRobot ``DatasetReader``, whose data are loaded, for many frames at once.

    Numbers come from arrays. Other columns (images, text, language) go through LeRobot's own row conversion,
    and what concerns cameras (decoding, transforms, depth units) through LeRobot's own ``get_item``, which is
    handed the gathered row in place of its table. Frames of videos come from a source of their own, if there
    is one; image transforms are then still LeRobot's.

    Args:
        reader: LeRobot's.
        left_out: cameras and columns without numbers that items need not hold.
        columns: the numeric columns by key, if somebody has them already.
        frames: the source of videos' frames.

    ``whole`` tells whether items need nothing but what is gathered.

    Raises:
        ValueError: what LeRobot answers does not follow from the values asked for, and is left to it: some
            ``delta_timestamps`` are empty, or a value is missing (null) in a column that is not left out.
    """

    def __init__(
        self,
        reader: DatasetReader,
        left_out: Collection[str] = (),
        columns: dict[str, Column] | None = None,
        frames: Frames | None = None,
    ):
        self.left_out = frozenset(left_out)
        self._table: Any = reader.hf_dataset
        self.columns = numeric_columns(self._table) if columns is None else columns
        meta: Any = reader._meta
        self._windows = EpisodeWindows(
            np.asarray(meta.episodes["dataset_from_index"][:]),
            np.asarray(meta.episodes["dataset_to_index"][:]),
            reader._absolute_to_relative_idx,
        )
        self._tasks = meta.tasks.index.tolist()
        self._keys = [key for key in self._table.column_names if key not in self.left_out]
        self._steps = {
            key: tuple(steps)
            for key, steps in (reader.delta_indices or {}).items()
            if key not in self.left_out
        }
        if () in self._steps.values():
            raise ValueError("what an empty list of delta_timestamps gives is LeRobot's to say")
        self._offsets = {steps: np.asarray(steps, np.int64) for steps in self._steps.values()}
        slow = [key for key in self._keys if key not in self.columns]
        if self._steps and (gaps := [key for key in slow if has_gaps(self._table, key)]):
            raise ValueError(
                f"whether a window with a missing value of {gaps} is an error is LeRobot's to say"
            )
        self._slow_keys = [key for key in slow if key not in self._steps]
        self._slow_rows = self._table.select_columns(self._slow_keys)
        self._slow_chunks = {key: self._table.select_columns([key]) for key in slow if key in self._steps}
        self._frames = frames
        from_source = set() if frames is None else set(frames.cameras)
        cameras = set(meta.camera_keys) - self.left_out
        if reader._image_transforms is None:
            cameras -= from_source
        self.whole = not cameras and self._steps.keys() - from_source <= self.columns.keys()

    def __len__(self) -> int:
        return len(self._table)

    def without_cameras(self, reader: DatasetReader) -> "ChunkReader":
        """One that leaves all images out."""
        cameras: list[str] = reader._meta.camera_keys
        return ChunkReader(reader, self.left_out.union(cameras), self.columns)

    def items(self, reader: DatasetReader, rows: Int64[np.ndarray, " B"]) -> GatheredBatch | list[Item]:
        """What ``reader.get_item`` returns for each of these rows of its table."""
        gathered = GatheredBatch(self._gather(reader, rows))
        return gathered if self.whole else [self._finish(reader, item) for item in gathered]

    def _gather(self, reader: DatasetReader, rows: Int64[np.ndarray, " B"]) -> dict[str, Tensor | list[Any]]:
        """All values of the items, key by key in LeRobot's order, each of length B."""
        index, episode, task = (
            self.columns[key].take(rows) for key in ("index", "episode_index", "task_index")
        )
        windows = {
            steps: self._windows.rows(index, episode, offsets) for steps, offsets in self._offsets.items()
        }
        slow = [self._slow_rows[row] for row in rows.tolist()] if self._slow_keys else []
        frame_rows = {steps: each for steps, (each, _) in windows.items()}
        gathered: dict[str, Tensor | list[Any]] = {**self._gather_frames(reader, rows, episode, frame_rows)}
        for key in self._keys:
            if key in self.columns:
                wanted = frame_rows[self._steps[key]] if key in self._steps else rows
                gathered[key] = self.columns[key].gather(wanted)
            elif key in self._slow_chunks:
                gathered[key] = [None] * len(rows)  # keeps the place of what LeRobot fills in afterwards
            else:
                gathered[key] = [row[key] for row in slow]
        for key, steps in self._steps.items():
            gathered[f"{key}_is_pad"] = torch.from_numpy(windows[steps][1].copy())
        gathered["task"] = [self._tasks[number] for number in task.tolist()]
        return gathered

    def _gather_frames(
        self,
        reader: DatasetReader,
        rows: Int64[np.ndarray, " B"],
        episode: Int64[np.ndarray, " B"],
        windows: Mapping[tuple[int, ...], Int64[np.ndarray, "B T"]],
    ) -> dict[str, Tensor]:
        """Frames (B, T, 3, h, w) of videos; as in LeRobot without the time axis if T is 1."""
        if self._frames is None:
            return {}
        wanted = {
            key: windows[self._steps[key]] if key in self._steps else rows[:, None]
            for key in self._frames.cameras
        }
        moments = {key: Moments.of_rows(self.columns, each) for key, each in wanted.items()}
        frames = self._frames.gather(reader, episode, moments)
        return {key: value[:, 0] if value.shape[1] == 1 else value for key, value in frames.items()}

    def _finish(self, reader: DatasetReader, item: Item) -> Item:
        """Adds what only LeRobot's code provides: cameras, and chunks of columns that hold no numbers."""
        row = dict(item)
        frames = {key: row.pop(key) for key in (() if self._frames is None else self._frames.cameras)}
        rest: Any = copy.copy(reader)
        rest._query_videos = _with_frames(reader, frames)
        rest.hf_dataset = GatheredRow(row, self.columns["timestamp"], self._slow_chunks)
        rest._meta = MetadataWithout(rest._meta, self.left_out)
        rest.delta_indices = {
            key: list(steps) for key, steps in self._steps.items() if key not in self.columns
        } or None
        return rest.get_item(item["index"])


def _with_frames(reader: DatasetReader, frames: Mapping[str, Tensor]) -> Callable[..., dict[str, Tensor]]:
    """LeRobot's ``_query_videos``, which decodes; these frames are there already."""

    def query(timestamps: dict[str, list[float]], episode: int) -> dict[str, Tensor]:
        rest = {key: each for key, each in timestamps.items() if key not in frames}
        found = {**frames, **(reader._query_videos(rest, episode) if rest else {})}
        return {key: found[key] for key in timestamps}

    return query


class MetadataWithout:
    """LeRobot's metadata of a dataset, without some of its cameras."""

    def __init__(self, meta: Any, left_out: frozenset[str]):
        self._meta = meta
        self._left_out = left_out

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._meta, name)
        cameras = name in ("camera_keys", "video_keys")
        return [key for key in value if key not in self._left_out] if cameras else value


class GatheredRow:
    """Stands in for the table inside LeRobot's ``get_item``: the wanted row is there already.

    LeRobot asks it for the row itself (a number), for the timestamps of a chunk of video frames (a list of
    rows), and for a column of images to take a chunk from (a key).
    """

    def __init__(self, item: Item, timestamps: Column, chunks: dict[str, datasets.Dataset]):
        self._item = item
        self._timestamps = timestamps
        self._chunks = chunks

    def __getitem__(self, key: int | Tensor | list[int] | str) -> Any:
        if isinstance(key, str):
            return self._chunks[key][key]
        if isinstance(key, list):
            return {"timestamp": list(self._timestamps.gather(np.asarray(key)))}
        return self._item


def parts(reader: DatasetReader) -> tuple[object, ...]:
    """Everything a ``ChunkReader`` is built from; one is out of date when another object is in a place."""
    table, meta = reader.hf_dataset, reader._meta
    return (
        table,
        getattr(table, "_format_kwargs", None),  # replaced by every set_transform and set_format
        reader.delta_indices,
        reader._absolute_to_relative_idx,
        reader._image_transforms,
        meta.episodes,
        meta.tasks,
        torch.get_default_dtype(),
    )
