"""When demonstrators rest: before they begin, after they are done, and in between."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

SMOOTHING_S = 0.2
"""Time over which the speed is averaged [s]."""
IDLE = 0.02
"""Share of an episode's peak speed below which nothing is done."""
PAUSE_S = 0.5
"""How long that lasts within an episode to be a pause [s]."""


@dataclass(frozen=True)
class Stillness:
    """Of one episode.

    Attributes:
        speed: (L - 1,) norm of the velocity [standard deviations per second], averaged over 0.2 s.
        idle: (L - 1,) whether that is below 2 % of the episode's peak.
        start: idle steps before the first motion.
        end: idle steps after the last.
        pauses: (first step, steps) of each rest in between.
    """

    speed: np.ndarray
    idle: np.ndarray
    start: int
    end: int
    pauses: tuple[tuple[int, int], ...]

    @property
    def pace(self) -> float:
        """Median speed in motion [standard deviations per second]."""
        return float(np.median(self.speed[~self.idle])) if not self.idle.all() else 0.0


@dataclass(frozen=True)
class Rests:
    """Of all episodes, as shares of all frames and in seconds.

    Attributes:
        start_share: idle before the first motion.
        start_median_s: of the episodes.
        start_longest_s: of the episodes.
        end_share: idle after the last motion.
        end_median_s: of the episodes.
        end_longest_s: of the episodes.
        pause_share: pauses in between.
        pauses_per_episode: their number.
        pause_longest_s: the longest.
    """

    start_share: float
    start_median_s: float
    start_longest_s: float
    end_share: float
    end_median_s: float
    end_longest_s: float
    pause_share: float
    pauses_per_episode: float
    pause_longest_s: float


def find_stillness(rows: np.ndarray, scale: np.ndarray, fps: float) -> Stillness:
    """When nothing is done in an episode.

    Args:
        rows: (L, D) of the dimensions that move.
        scale: (D,) standard deviations.
        fps: frames per second.
    """
    window = max(1, round(SMOOTHING_S * fps))
    velocity = np.linalg.norm(np.diff(rows, axis=0) / scale, axis=1) * fps
    speed = ndimage.uniform_filter1d(velocity, window, mode="nearest") if len(velocity) else velocity
    idle = speed <= IDLE * speed.max(initial=0.0)
    busy = np.flatnonzero(~idle)
    if not len(busy):
        return Stillness(speed, idle, len(idle), 0, ())
    first, last = int(busy[0]), int(busy[-1])
    return Stillness(speed, idle, first, len(idle) - 1 - last, _pauses(idle, first, last, fps))


def summarise(found: Sequence[Stillness], fps: float) -> Rests:
    """Of all episodes together."""
    frames = sum(len(each.idle) + 1 for each in found)
    start, end = (np.array([getattr(each, side) for each in found]) for side in ("start", "end"))
    pauses = np.array([steps for each in found for _, steps in each.pauses])
    return Rests(
        start_share=float(start.sum() / frames),
        start_median_s=float(np.median(start) / fps),
        start_longest_s=float(start.max() / fps),
        end_share=float(end.sum() / frames),
        end_median_s=float(np.median(end) / fps),
        end_longest_s=float(end.max() / fps),
        pause_share=float(pauses.sum() / frames),
        pauses_per_episode=len(pauses) / len(found),
        pause_longest_s=float(pauses.max(initial=0) / fps),
    )


def _pauses(idle: np.ndarray, first: int, last: int, fps: float) -> tuple[tuple[int, int], ...]:
    edges = np.flatnonzero(np.diff(idle[first : last + 1].astype(int), prepend=0, append=0))
    runs = ((first + int(begin), int(end - begin)) for begin, end in edges.reshape(-1, 2))
    return tuple((begin, steps) for begin, steps in runs if steps >= PAUSE_S * fps)
