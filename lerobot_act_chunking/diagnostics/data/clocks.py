"""Whether frames were recorded as often as the dataset says."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_act_chunking.diagnostics.core.recording import Recording

UNITS_S = (1.0, 1e-3, 1e-6, 1e-9)
"""Seconds and what else clocks count in."""
LIKELY = 3.0
"""Factor between the rates by a clock and by ``fps`` beyond which the column is no clock."""
GAP = 1.5
"""Control periods between two frames from which one is missing."""
COUNTED = 0.01
"""Control periods by which frame / fps may be rounded."""


@dataclass(frozen=True)
class Clock:
    """A column that says when each frame was taken.

    Attributes:
        column: its name.
        rate_hz: frames per second by it.
        shortest_s: time between two frames, at least.
        median_s: half of the times.
        longest_s: at most.
        gaps: times of more than one and a half control periods: frames are missing.
        backwards: times of 0 or less.
        counted: whether it is only the number of the frame, divided by ``fps``.
    """

    column: str
    rate_hz: float
    shortest_s: float
    median_s: float
    longest_s: float
    gaps: int
    backwards: int
    counted: bool

    def off(self, fps: float) -> float:
        """By what share frames are further apart (above 0) or closer than ``fps`` says."""
        return fps / self.rate_hz - 1


def read_clocks(recording: Recording) -> list[Clock]:
    """Every column that is a clock."""
    found = (
        _clock(column, [each.clocks[column] for each in recording.episodes], recording.fps)
        for column in recording.episodes[0].clocks
    )
    return [each for each in found if each is not None]


def _clock(column: str, times: Sequence[np.ndarray], fps: float) -> Clock | None:
    steps = np.concatenate([np.diff(each).astype(np.float64) for each in times])
    if not len(steps) or not np.isfinite(steps).all() or not steps.sum() > 0:
        return None
    units = [unit for unit in UNITS_S if 1 / LIKELY < 1 / (unit * steps.mean() * fps) < LIKELY]
    if not units:
        return None
    seconds = units[0] * steps
    return Clock(
        column=column,
        rate_hz=float(1 / seconds.mean()),
        shortest_s=float(seconds.min()),
        median_s=float(np.median(seconds)),
        longest_s=float(seconds.max()),
        gaps=int((seconds * fps > GAP).sum()),
        backwards=int((seconds <= 0).sum()),
        counted=bool((np.abs(seconds * fps - 1) < COUNTED).all()),
    )
