"""A ``LeRobotDataset`` that reads fast."""

import functools
import logging
from collections.abc import Callable, Sequence
from operator import index
from typing import Any, SupportsIndex, cast

import numpy as np
from jaxtyping import Int64
from lerobot.datasets.dataset_reader import DatasetReader
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_act_chunking.data.fast_chunks.agreement import differing_key
from lerobot_act_chunking.data.fast_chunks.batch import GatheredBatch, Item
from lerobot_act_chunking.data.fast_chunks.factory_patch import SWITCH
from lerobot_act_chunking.data.fast_chunks.frames.filling import fill_in_background
from lerobot_act_chunking.data.fast_chunks.frames.source import Frames
from lerobot_act_chunking.data.fast_chunks.reader import ChunkReader, parts
from lerobot_act_chunking.data.fast_chunks.reading import Reading
from lerobot_act_chunking.data.fast_chunks.rows import check_rows

NOT_NUMBERS = ("image", "video", "string", "language")

logger = logging.getLogger(__name__)


class FastChunkDataset(LeRobotDataset):
    """LeRobot's dataset with the same arguments and the same items, gathered from columnar memory.

    Whatever is not a plain read (a dataset being written, a slice, an index beyond the end) is left to
    LeRobot, and so is all that fails here: LeRobot then gives the item, or its own error.

    Where ``delta_timestamps`` are a ``Reading``, its rows are checked first, and items hold no cameras and no
    text that it does not list.

    Raises:
        DatasetError: rows that a ``Reading`` lists cannot be learned from.
    """

    _chunks: ChunkReader | None = None
    _blind: ChunkReader | None = None
    _built_from: tuple[object, ...] | None = None
    _frames: Frames | None = None

    def __init__(self, *args: Any, **kwargs: Any):
        super().__init__(*args, **kwargs)
        stamps = self.delta_timestamps
        self._reading = stamps if isinstance(stamps, Reading) else None
        if self._reading is not None:
            check_rows(self, self._reading)
        self._open_frames()
        _ = self.chunks  # now, so that forked data workers share the arrays instead of building their own

    @property
    def chunks(self) -> ChunkReader | None:
        """The columnar reader, rebuilt when LeRobot replaced its table; None where LeRobot's own works."""
        reader = self.reader
        if self.writer is not None or reader is None or reader.hf_dataset is None:
            return None
        now = parts(reader)
        if self._built_from is None or any(a is not b for a, b in zip(now, self._built_from, strict=True)):
            self._built_from = now
            self._build(reader)
        return self._chunks

    def _open_frames(self) -> None:
        """Videos that are read as bytes, as LeRobot's factory asks for, come out of the frame cache."""
        reader: Any = self.reader
        if self.writer is not None or reader is None or not reader._return_uint8:
            return
        left_out = {*self._left_out(), *self.meta.depth_keys}
        cameras = [key for key in self.meta.video_keys if key not in left_out]
        if cameras:
            size = None if self._reading is None else self._reading.resize_shape
            self._frames = Frames(reader, cameras, size, len(self))
            fill_in_background(self, self._frames)

    def _build(self, reader: DatasetReader) -> None:
        try:
            chunks = ChunkReader(reader, self._left_out(), frames=self._frames)
            key = differing_key(chunks, reader)
            self._blind = None if self._reading is None else chunks.without_cameras(reader)
        except Exception as error:
            self._turn_off(repr(error))
            return
        if key is None:
            self._chunks = chunks
            _say_once()
        else:
            self._turn_off(f"LeRobot has another {key!r}")

    def _turn_off(self, reason: str) -> None:
        self._chunks = None
        logger.warning("fast chunks are off for %s: %s", self.repo_id, reason)

    def _left_out(self) -> set[str]:
        """Cameras, text and the like that nobody reads; unread numbers cost nothing."""
        if self._reading is None:
            return set()
        dtypes = {key: feature["dtype"] for key, feature in self.meta.features.items()}
        return {key for key in dtypes.keys() - self._reading.columns if dtypes[key] in NOT_NUMBERS}

    def __getitem__(self, idx: SupportsIndex | slice) -> Item | list[Item]:
        """One frame, or the frames of a slice, as in ``LeRobotDataset``."""
        return super().__getitem__(idx) if isinstance(idx, slice) else dict(self.__getitems__([idx])[0])

    def __getitems__(self, indices: Sequence[SupportsIndex]) -> GatheredBatch | list[Item]:
        """The items of a whole batch, gathered at once: ``torch.utils.data.DataLoader`` asks for these."""
        gathered = self._gathered(indices)
        if gathered is not None:
            return gathered
        one = cast("Callable[[SupportsIndex], Item]", super().__getitem__)
        return [one(idx) for idx in indices]

    def _gathered(self, indices: Sequence[SupportsIndex]) -> GatheredBatch | list[Item] | None:
        """The items; None if they are left to LeRobot."""
        chunks = self.chunks
        rows = None if chunks is None else _rows(indices, len(chunks))
        if chunks is None or rows is None:
            return None
        switch = None if self._reading is None else self._reading.image_switch
        if self._blind is not None and switch is not None and switch.off:
            chunks = self._blind
        try:
            return chunks.items(self.reader, rows)
        except Exception as error:
            self._turn_off(repr(error))
            return None

    def __getstate__(self) -> dict[str, Any]:
        """Without the arrays: a spawned data worker maps LeRobot's table and builds its own."""
        return {**self.__dict__, "_chunks": None, "_blind": None, "_built_from": None}


@functools.cache
def _say_once() -> None:
    logger.info("datasets are read with fast chunks (%s=0 turns them off)", SWITCH)


def _rows(indices: Sequence[SupportsIndex], count: int) -> Int64[np.ndarray, " B"] | None:
    """Rows of the table, negative ones counted from its end; None if there are none or some lie beyond."""
    rows = [index(each) for each in indices]
    if not rows or min(rows) < -count or max(rows) >= count:
        return None
    return np.array(rows) % count
