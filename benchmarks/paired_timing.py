"""Two programs timed in turns, so that whatever else the machine does hits both alike."""

import statistics
import time
from collections.abc import Callable, Sequence

import torch

Medians = tuple[float, float, float]
"""Of both times [ms], and of the ratios second / first within a turn."""


def compare(theirs: Callable[[], object], ours: Callable[[], object], repeats: int) -> Medians:
    """Time both in turns, after one untimed turn."""
    return medians([(milliseconds(theirs), milliseconds(ours)) for _ in range(repeats + 1)][1:])


def medians(times: Sequence[Sequence[float]]) -> Medians:
    """Of turns with the times of both."""
    theirs, ours = (statistics.median(column) for column in zip(*times, strict=True))
    return theirs, ours, statistics.median(b / a for a, b in times)


def milliseconds(call: Callable[[], object]) -> float:
    """Wall time of one call."""
    start = time.perf_counter()
    call()
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    return 1e3 * (time.perf_counter() - start)
