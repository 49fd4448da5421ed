"""Trust, but verify: a dataset's first and last item against LeRobot's own reader."""

from typing import Any

import numpy as np
from lerobot.datasets.dataset_reader import DatasetReader
from torch import Tensor

from lerobot_act_chunking.data.fast_chunks.batch import Item
from lerobot_act_chunking.data.fast_chunks.reader import ChunkReader


def differing_key(chunks: ChunkReader, reader: DatasetReader) -> str | None:
    """The first key in which ``chunks`` and LeRobot's ``reader`` disagree, None if they agree.

    Cameras are left out: their part is LeRobot's own code, and LeRobot warns of decoding videos here, before
    data workers are forked.
    """
    for row in {0, len(chunks) - 1}:
        ours, theirs = _items(chunks, reader, row)
        if list(ours) != list(theirs):
            return next(iter(ours.keys() ^ theirs.keys()), "order of keys")
        for key in theirs:
            if not _equal(ours[key], theirs[key]):
                return key
    return None


def _items(chunks: ChunkReader, reader: DatasetReader, row: int) -> tuple[Item, Item]:
    rows = np.asarray([row])
    if chunks.whole and not reader._meta.camera_keys:
        theirs = reader.get_item(row)
        return dict(chunks.items(reader, rows)[0]), {
            key: value for key, value in theirs.items() if key not in chunks.left_out
        }
    table: Any = reader.hf_dataset
    theirs = {key: value for key, value in table[row].items() if key in chunks.columns}
    return {key: column.gather(rows)[0] for key, column in chunks.columns.items()}, theirs


def _equal(ours: Any, theirs: Any) -> bool:
    if not isinstance(ours, Tensor) or not isinstance(theirs, Tensor):
        return type(ours) is type(theirs) and ours == theirs
    if ours.dtype != theirs.dtype or ours.shape != theirs.shape:
        return False
    both_nan = (ours != ours) & (theirs != theirs)
    return bool(((ours == theirs) | both_nan).all())
