"""Smooth motion: minimum-jerk strokes that overlap, and a clock that can linger."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lerobot_act_chunking.envs.aloha.world import CONTROL_PERIOD

_PAUSE_WINDOW = 0.1  # stretch [s] of the script over which a pause is spread, so that nothing stops at once


@dataclass(frozen=True)
class Stroke:
    """One movement of a script.

    Attributes:
        start, end: when it happens [s of the script]; a negative start has the arm on its way at once.
        target: (D,) where it leads.
        free: whether the task leaves the target free, so that way-point noise may shift it.
    """

    start: float
    end: float
    target: tuple[float, ...]
    free: bool = False


@dataclass(frozen=True)
class ArmScript:
    """Strokes of one arm: tool poses (x, y, z, pitch, roll) and gripper openings (1,)."""

    tool: tuple[Stroke, ...]
    gripper: tuple[Stroke, ...]


@dataclass(frozen=True)
class Script:
    """Both arms over one episode.

    Attributes:
        duration: length [s] at nominal pace.
        pauses: moments [s] at which a dwell is inserted.
    """

    left: ArmScript
    right: ArmScript
    duration: float
    pauses: tuple[float, ...]


def minimum_jerk(phase: np.ndarray) -> np.ndarray:
    """The minimum-jerk profile from 0 to 1 (Flash & Hogan 1985), constant outside 0 .. 1."""
    phase = np.clip(phase, 0.0, 1.0)
    return phase**3 * (10 - 15 * phase + 6 * phase**2)


def blend(times: np.ndarray, origin: Sequence[float] | np.ndarray, strokes: Sequence[Stroke]) -> np.ndarray:
    """Superpose strokes: each adds its displacement in its own time, so overlapping ones round the corner.

    Args:
        times: (T,) [s].
        origin: (D,) value before the first stroke.
        strokes: in the order in which their targets follow each other.

    Returns:
        (T, D); two times continuously differentiable, and never beyond a target unless strokes overlap.
    """
    value = np.asarray(origin, dtype=np.float64)
    path = np.tile(value, (len(times), 1))
    for stroke in strokes:
        target = np.asarray(stroke.target, dtype=np.float64)
        phase = (times - stroke.start) / (stroke.end - stroke.start)
        path += minimum_jerk(phase)[:, None] * (target - value)
        value = target
    return path


def shift_free(strokes: Sequence[Stroke], scale: float, rng: np.random.Generator) -> tuple[Stroke, ...]:
    """Move the position (first three numbers) of each free target by normal noise of ``scale`` [m]."""

    def shifted(stroke: Stroke) -> Stroke:
        offset = scale * rng.standard_normal(3)
        position = (np.asarray(stroke.target[:3]) + offset).tolist()
        return replace(stroke, target=(*position, *stroke.target[3:]))

    return tuple(shifted(stroke) if stroke.free else stroke for stroke in strokes)


def script_times(duration: float, pauses: Sequence[float], speed: float, dwell: float) -> np.ndarray:
    """Moments of the script [s] at which the control steps fall.

    Args:
        duration: length of the script [s].
        pauses: moments of the script at which to linger.
        speed: pace of the script.
        dwell: how long to linger at each pause [s].

    Returns:
        (T,), increasing, from 0 to ``duration``.
    """
    script = np.arange(0.0, duration + 1e-9, CONTROL_PERIOD / 4)
    wall = script / speed
    for pause in pauses:
        wall = wall + dwell * minimum_jerk((script - pause) / _PAUSE_WINDOW + 0.5)
    steps = np.arange(0.0, wall[-1] + 1e-9, CONTROL_PERIOD)
    return np.interp(steps, wall, script)
