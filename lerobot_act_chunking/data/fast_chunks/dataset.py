"""A ``LeRobotDataset`` that reads fast."""

import logging
from collections.abc import Callable, Sequence
from operator import index
from typing import Any, SupportsIndex, cast

import numpy as np
from jaxtyping import Int64
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_act_chunking.data.fast_chunks.agreement import differing_key
from lerobot_act_chunking.data.fast_chunks.batch import GatheredBatch, Item
from lerobot_act_chunking.data.fast_chunks.reader import ChunkReader

logger = logging.getLogger(__name__)


class FastChunkDataset(LeRobotDataset):
    """LeRobot's dataset with the same arguments and the same items, gathered from columnar memory.

    Whatever is not a plain read (a dataset being written, a slice, an index beyond the end) is left to
    LeRobot.
    """

    _chunks: ChunkReader | None = None
    _agrees = False

    def __init__(self, *args: Any, **kwargs: Any):
        super().__init__(*args, **kwargs)
        _ = self.chunks  # now, so that forked data workers share the arrays instead of building their own

    @property
    def chunks(self) -> ChunkReader | None:
        """The columnar reader, rebuilt when LeRobot replaced its table; None where LeRobot's own works."""
        reader = self.reader
        if self.writer is not None or reader is None or reader.hf_dataset is None:
            return None
        if self._chunks is None or not self._chunks.is_current(reader):
            self._chunks = ChunkReader(reader)
            key = differing_key(self._chunks, reader)
            self._agrees = key is None
            if key is not None:
                logger.warning("fast chunks are off for %s: LeRobot has another %r", self.repo_id, key)
        return self._chunks if self._agrees else None

    def __getitem__(self, idx: SupportsIndex | slice) -> Item | list[Item]:
        """One frame, or the frames of a slice, as in ``LeRobotDataset``."""
        return super().__getitem__(idx) if isinstance(idx, slice) else dict(self.__getitems__([idx])[0])

    def __getitems__(self, indices: Sequence[SupportsIndex]) -> GatheredBatch | list[Item]:
        """The items of a whole batch, gathered at once: ``torch.utils.data.DataLoader`` asks for these."""
        chunks = self.chunks
        rows = None if chunks is None else _rows(indices, len(chunks))
        if chunks is None or rows is None:
            one = cast("Callable[[SupportsIndex], Item]", super().__getitem__)
            return [one(idx) for idx in indices]
        return chunks.items(self.reader, rows)

    def __getstate__(self) -> dict[str, Any]:
        """Without the arrays: a spawned data worker maps LeRobot's table and builds its own."""
        return {**self.__dict__, "_chunks": None}


def _rows(indices: Sequence[SupportsIndex], count: int) -> Int64[np.ndarray, " B"] | None:
    """Rows of the table, negative ones counted from its end; None if there are none or some lie beyond."""
    rows = [index(each) for each in indices]
    if not rows or min(rows) < -count or max(rows) >= count:
        return None
    return np.array(rows) % count
