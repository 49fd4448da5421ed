"""Numeric features of a LeRobot dataset as arrays, read once from its Arrow table."""

from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import datasets
import numpy as np
import pyarrow as pa
import torch
from jaxtyping import Int64, Shaped
from torch import Tensor

JOIN_LIMIT_BYTES = 512 * 2**20
"""Columns that together stay below this are copied into one array each (20 000 frames of ALOHA states: 4 MB).

Larger ones are gathered from LeRobot's memory-mapped pieces: slower, but without a second copy in memory.
"""


@dataclass(frozen=True)
class Column:
    """One numeric feature of every frame, in one or several pieces of consecutive rows.

    ``pieces`` are arrays (rows, *feature shape) of the stored type, possibly read-only maps of a file;
    ``first_rows`` holds the row at which each begins; ``dtype`` is the type of LeRobot's tensors.
    """

    pieces: list[Shaped[np.ndarray, "_ ..."]]
    first_rows: Int64[np.ndarray, " pieces"]
    dtype: torch.dtype

    def gather(self, rows: Int64[np.ndarray, "..."]) -> Shaped[Tensor, "..."]:
        """Copies of the given rows, shape (*rows.shape, *feature shape); writing into them is harmless.

        Raises:
            IndexError: if a row lies beyond the dataset.
        """
        tensor = torch.from_numpy(self.take(rows))
        return tensor if tensor.dtype is self.dtype else tensor.to(self.dtype)

    def take(self, rows: Int64[np.ndarray, "..."]) -> Shaped[np.ndarray, "..."]:
        """``gather`` as an array of the stored type."""
        return self.pieces[0].take(rows, axis=0) if len(self.pieces) == 1 else self._take_pieces(rows)

    def _take_pieces(self, rows: Int64[np.ndarray, "..."]) -> Shaped[np.ndarray, "..."]:
        flat = rows.ravel()
        piece = np.searchsorted(self.first_rows, flat, side="right") - 1
        values = np.empty((flat.size, *self.pieces[0].shape[1:]), self.pieces[0].dtype)
        # A chunk is a run of neighbouring rows: loop over the changes of piece, which are few.
        for start, stop in pairwise([0, *np.flatnonzero(np.diff(piece)) + 1, flat.size]):
            source = piece[start]
            values[start:stop] = self.pieces[source].take(flat[start:stop] - self.first_rows[source], axis=0)
        return values.reshape(*rows.shape, *values.shape[1:])


def numeric_columns(table: datasets.Dataset) -> dict[str, Column]:
    """The columns of ``table`` that hold numbers of one shape without gaps; all others are left out."""
    shapes = {key: _frame_shape(feature) for key, feature in table.features.items()}
    fixed = {key: shape for key, shape in shapes.items() if shape is not None}
    arrow = cast("pa.Table", table.select_columns(list(fixed)).with_format("arrow")[:])
    numeric = {key: pieces for key, shape in fixed.items() if (pieces := _pieces(arrow.column(key), shape))}
    join = sum(piece.nbytes for pieces in numeric.values() for piece in pieces) <= JOIN_LIMIT_BYTES
    return {key: _column(pieces, join=join) for key, pieces in numeric.items()}


def has_gaps(table: datasets.Dataset, key: str) -> bool:
    """Whether some value of a column, or some number in one, is missing (null)."""
    chunks = cast("pa.ChunkedArray", table.data.column(key)).chunks
    return any(_flat(chunk).null_count > 0 for chunk in chunks)


def _column(pieces: list[np.ndarray], *, join: bool) -> Column:
    if join and len(pieces) > 1:
        pieces = [np.concatenate(pieces)]
    first_rows = np.cumsum([0, *(len(piece) for piece in pieces[:-1])])
    return Column(pieces, first_rows, _lerobot_dtype(pieces[0].dtype))


def _lerobot_dtype(stored: np.dtype) -> torch.dtype:
    """The type of LeRobot's ``torch.tensor(python_value)``: one for all integers, one for all floats."""
    return {"b": torch.bool, "i": torch.int64, "u": torch.int64, "f": torch.get_default_dtype()}[stored.kind]


def _frame_shape(feature: object) -> tuple[int, ...] | None:
    """Shape of one frame's value, None if frames may differ or the feature is nothing numeric."""
    if isinstance(feature, datasets.Value):
        return ()
    if isinstance(feature, datasets.List) and isinstance(feature.feature, datasets.Value):
        return (feature.length,) if feature.length > 0 else None
    shape = getattr(feature, "shape", None)  # Array2D to Array5D; a size of None means that it varies
    return tuple(shape) if shape and all(shape) else None


def _pieces(column: pa.ChunkedArray, shape: tuple[int, ...]) -> list[np.ndarray]:
    """Arrays (rows, *shape), copies only where Arrow packs bits; no arrays if some value is no number."""
    chunks = [chunk for chunk in column.chunks if len(chunk)]
    numbers = [array for chunk in chunks if (array := _numbers(chunk)) is not None]
    if len(numbers) < len(chunks):
        return []
    return [array.to_numpy(zero_copy_only=False).reshape(-1, *shape) for array in numbers]


def _numbers(chunk: pa.Array) -> pa.Array | None:
    """The flat values of a chunk, None for gaps and for other things than numbers."""
    array = _flat(chunk)
    kind = array.type
    number = pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind)
    # A uint64 may exceed torch's int64; LeRobot's error for that is LeRobot's to raise.
    return array if number and array.null_count == 0 and not pa.types.is_uint64(kind) else None


def _flat(chunk: pa.Array) -> pa.Array:
    """The innermost values of lists in lists, or the outermost lists among which one is missing."""
    array = chunk.storage if isinstance(chunk, pa.ExtensionArray) else chunk
    while (
        isinstance(array, pa.ListArray | pa.LargeListArray | pa.FixedSizeListArray) and array.null_count == 0
    ):
        array = array.flatten()
    return array
