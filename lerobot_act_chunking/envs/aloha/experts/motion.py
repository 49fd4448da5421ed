"""Smooth motion: minimum-jerk strokes that overlap, and a clock that can linger."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lerobot_act_chunking.envs.aloha.world import CONTROL_PERIOD
from lerobot_act_chunking.envs.demonstration import minimum_jerk

PAUSE_WINDOW = 0.1  # stretch [s] of the script over which a pause is spread, so that nothing stops at once
_MISSED_BY = 0.06  # height [m] above the object at which fingers close that miss it
_RETRY = 1.2  # [s] from a missed grasp to the next
_HEAD_START = 1.85  # [s] by which one arm begins before the other: until it has grasped
_MEETING = 2.9  # [s] from which on the arms move to each other


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
        pauses_after: moments [s] right after a contact, or before two parts meet.
        leading_arm: the arm that closes its fingers on nothing if a grasp is missed, and that goes first if
            one arm moves after the other.
    """

    left: ArmScript
    right: ArmScript
    duration: float
    pauses: tuple[float, ...]
    pauses_after: tuple[float, ...] = ()
    leading_arm: str = "right"

    @property
    def waiting_arm(self) -> str:
        """The arm that does not lead."""
        return "left" if self.leading_arm == "right" else "right"

    @property
    def leading(self) -> ArmScript:
        """The script of the leading arm."""
        return self.right if self.leading_arm == "right" else self.left

    @property
    def waiting(self) -> ArmScript:
        """The script of the other arm."""
        return self.left if self.leading_arm == "right" else self.right

    @property
    def beginning(self) -> float:
        """When [s] the first stroke begins; before 0, where an episode without a rest joins it."""
        return min(stroke.start for arm in (self.left, self.right) for stroke in (*arm.tool, *arm.gripper))

    @property
    def end(self) -> float:
        """When [s] the last stroke has ended, past the ``duration`` of an episode without a rest."""
        return max(stroke.end for arm in (self.left, self.right) for stroke in (*arm.tool, *arm.gripper))


def steady_speed(phase: np.ndarray) -> np.ndarray:
    """The profile that starts and stops at once and goes at constant speed in between."""
    return np.clip(phase, 0.0, 1.0)


def overshooting(phase: np.ndarray, share: float) -> np.ndarray:
    """The minimum-jerk profile that goes ``share`` too far around its end and is corrected right after.

    As two submovements of a hand: the first too long, the second back (Meyer et al. 1988).
    """
    return minimum_jerk(phase) + share * _bump((phase - 0.75) / 0.45)


def blend(
    times: np.ndarray,
    origin: Sequence[float] | np.ndarray,
    strokes: Sequence[Stroke],
    overshoot: float = 0.0,
    *,
    constant_speed: bool = False,
) -> np.ndarray:
    """Superpose strokes: each adds its displacement in its own time, so overlapping ones round the corner.

    Args:
        times: (T,) [s].
        origin: (D,) value before the first stroke.
        strokes: in the order in which their targets follow each other.
        overshoot: of strokes to free targets, as a share of their displacement.
        constant_speed: start and stop at once, in place of minimum-jerk strokes.

    Returns:
        (T, D); two times continuously differentiable but with ``constant_speed``, and never beyond a target
        unless strokes overlap or overshoot.
    """
    value = np.asarray(origin, dtype=np.float64)
    plain = steady_speed if constant_speed else minimum_jerk
    path = np.tile(value, (len(times), 1))
    for stroke in strokes:
        target = np.asarray(stroke.target, dtype=np.float64)
        phase = (times - stroke.start) / (stroke.end - stroke.start)
        profile = overshooting(phase, overshoot) if stroke.free and overshoot else plain(phase)
        path += profile[:, None] * (target - value)
        value = target
    return path


def shift_free(strokes: Sequence[Stroke], scale: float, rng: np.random.Generator) -> tuple[Stroke, ...]:
    """Move the position (first three numbers) of each free target by normal noise of ``scale`` [m]."""

    def shifted(stroke: Stroke) -> Stroke:
        offset = scale * rng.standard_normal(3)
        position = (np.asarray(stroke.target[:3]) + offset).tolist()
        return replace(stroke, target=(*position, *stroke.target[3:]))

    return tuple(shifted(stroke) if stroke.free else stroke for stroke in strokes)


def detour_of(times: np.ndarray, strokes: Sequence[Stroke], size: float) -> np.ndarray:
    """Shift (T,) [m] that leads an approach around by ``size`` and is over before the fingers close."""
    approach, descent, *_ = strokes
    return size * _bump((times - approach.start) / (descent.end - 0.4 - approach.start))


def _bump(phase: np.ndarray) -> np.ndarray:
    """A smooth hill of height 1 between 0 and 1."""
    phase = np.clip(phase, 0.0, 1.0)
    return 64 * phase**3 * (1 - phase) ** 3


def miss_first_grasp(script: Script) -> Script:
    """The script whose ``leading_arm`` closes its fingers above the object, opens them, and then grasps.

    What begins after the grasp, of both arms, comes ``_RETRY`` later.
    """
    arm = script.leading
    approach, descent, *_ = arm.tool
    opening, closing, *_ = arm.gripper
    x, y, z, *angles = descent.target
    too_high = replace(descent, target=(x, y, z + _MISSED_BY, *angles))
    reopening = Stroke(closing.end + 0.15, closing.end + 0.55, opening.target)
    further_down = Stroke(
        max(descent.end + 0.35, reopening.start + 0.1), descent.end + _RETRY, descent.target
    )
    after = _delayed_arm(ArmScript(arm.tool[2:], arm.gripper[1:]), _RETRY, -np.inf)
    missed = ArmScript(
        tool=(approach, too_high, further_down, *after.tool),
        gripper=(opening, closing, reopening, *after.gripper),
    )
    waiting = _delayed_arm(script.waiting, _RETRY, descent.end - 0.1)
    return _delayed(script, {script.leading_arm: missed, script.waiting_arm: waiting}, _RETRY, 0.0)


def one_arm_after_the_other(script: Script) -> Script:
    """The script in which the other arm begins only when the ``leading_arm`` has grasped.

    The leading arm waits for it before the two meet.
    """
    leading = _delayed_arm(script.leading, _HEAD_START, _MEETING)
    waiting = _delayed_arm(script.waiting, _HEAD_START, -np.inf)
    arms = {script.leading_arm: leading, script.waiting_arm: waiting}
    return _delayed(script, arms, _HEAD_START, _MEETING)


def _delayed(script: Script, arms: dict[str, ArmScript], delay: float, after: float) -> Script:
    """The script with these arms, and what comes ``after`` [s] later by ``delay`` [s]."""

    def later(moments: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(moment + delay if moment >= after else moment for moment in moments)

    return replace(
        script,
        **arms,
        duration=script.duration + delay,
        pauses=later(script.pauses),
        pauses_after=later(script.pauses_after),
    )


def _delayed_arm(arm: ArmScript, delay: float, after: float) -> ArmScript:
    """The arm whose strokes that begin ``after`` [s] come later by ``delay`` [s]."""

    def later(strokes: tuple[Stroke, ...]) -> tuple[Stroke, ...]:
        return tuple(
            replace(stroke, start=stroke.start + delay, end=stroke.end + delay)
            if stroke.start >= after
            else stroke
            for stroke in strokes
        )

    return ArmScript(later(arm.tool), later(arm.gripper))


def script_times(
    span: tuple[float, float],
    pauses: Sequence[tuple[float, float]],
    speed: float | np.ndarray,
    *,
    window: float = PAUSE_WINDOW,
) -> np.ndarray:
    """Moments of the script [s] at which the control steps fall.

    Args:
        span: first and last moment of the script [s].
        pauses: moments of the script [s] at which to linger, and for how long [s].
        speed: pace of the script; or its pace at each of ``fine_moments(span)``.
        window: stretch [s] of the script over which each pause is spread; at 0 the script stands still.

    Returns:
        (T,), increasing, from the first moment to the last.
    """
    script = fine_moments(span)
    wall = _elapsed(script, speed) if isinstance(speed, np.ndarray) else (script - span[0]) / speed
    for moment, dwell in pauses:
        share = minimum_jerk((script - moment) / window + 0.5) if window else script > moment
        wall = wall + dwell * share
    steps = np.arange(0.0, wall[-1] + 1e-9, CONTROL_PERIOD)
    return np.interp(steps, wall, script)


def fine_moments(span: tuple[float, float]) -> np.ndarray:
    """Moments of the script [s], four to a control period."""
    return np.arange(span[0], span[1] + 1e-9, CONTROL_PERIOD / 4)


def _elapsed(script: np.ndarray, speed: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(np.diff(script) / speed[1:])])
