"""Which rows a chunk covers: LeRobot's rule for delta timestamps, for a whole batch at once."""

import numpy as np
from jaxtyping import Bool, Int64


class EpisodeWindows:
    """Maps frames and frame offsets to rows of the loaded table.

    A frame has an *index* counted over the whole dataset and a *row* in the loaded table; they differ when
    only some episodes were loaded. Episode e covers ``first[e] <= index < end[e]``. An offset that leaves the
    episode yields the episode's nearest frame, marked as padding::

        index       0 1 2 | 3 4 5 6        first = [0, 3], end = [3, 7]
        frame 4, offsets -2 -1 0 1 2 3:  indices 3 3 4 5 6 6,  padding 1 0 0 0 0 1
    """

    def __init__(
        self,
        first: Int64[np.ndarray, " episodes"],
        end: Int64[np.ndarray, " episodes"],
        row_of_index: dict[int, int] | None,
    ):
        self._first = first
        self._last = end - 1
        self._row_of_index = None if row_of_index is None else _lookup(row_of_index, size=int(end.max()))

    def rows(
        self,
        index: Int64[np.ndarray, " B"],
        episode: Int64[np.ndarray, " B"],
        offsets: Int64[np.ndarray, " T"],
    ) -> tuple[Int64[np.ndarray, "B T"], Bool[np.ndarray, "B T"]]:
        """Row and padding flag of every offset around every frame."""
        wanted = index[:, None] + offsets
        inside = np.minimum(np.maximum(wanted, self._first[episode, None]), self._last[episode, None])
        rows = inside if self._row_of_index is None else self._row_of_index[inside]
        return rows, inside != wanted


def _lookup(row_of_index: dict[int, int], size: int) -> Int64[np.ndarray, " frames"]:
    # A frame that was not loaded maps beyond every table: gathering it raises instead of wrapping around.
    rows = np.full(size, np.iinfo(np.int64).max)
    index = np.fromiter(row_of_index, np.int64)
    known = (index >= 0) & (index < size)  # no window reaches others
    rows[index[known]] = np.fromiter(row_of_index.values(), np.int64)[known]
    return rows
