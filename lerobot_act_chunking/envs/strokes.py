"""Smooth scripted motion of any robot: minimum-jerk strokes that overlap, and a clock that can linger."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from lerobot_act_chunking.envs.demonstration import (
    ExpertOptions,
    correlated_noise,
    minimum_jerk,
    wandering_pace,
)
from lerobot_act_chunking.errors import ConfigurationError

PAUSE_WINDOW = 0.1  # stretch [s] of the script over which a pause is spread, so that nothing stops at once


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
    """Strokes of one arm: tool poses (x, y, z and two angles) and gripper openings (1,)."""

    tool: tuple[Stroke, ...]
    gripper: tuple[Stroke, ...]


class Timing(Protocol):
    """When things happen in a script [s]."""

    @property
    def beginning(self) -> float:
        """Of the first stroke; before 0, where an episode without a rest joins it."""
        ...

    @property
    def duration(self) -> float:
        """Length of an episode without a rest, at nominal pace."""
        ...

    @property
    def end(self) -> float:
        """Of the last stroke."""
        ...

    @property
    def pauses(self) -> Sequence[float]:
        """Moments at which a dwell is inserted."""
        ...

    @property
    def pauses_after(self) -> Sequence[float]:
        """Moments right after a contact, or before two parts meet."""
        ...


@dataclass(frozen=True)
class ExpertPlan:
    """A whole episode: a row for each control step, in the order and units of the robot's actions.

    Attributes:
        actions: (T, A) clean targets, what a dataset records as the action.
        commands: (T, A) what is executed: ``actions``, disturbed and late; see `executed`.
    """

    actions: np.ndarray
    commands: np.ndarray


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


def miss_grasp(arm: ArmScript, *, height: float, retry: float) -> ArmScript:
    """The script of an arm that closes its fingers ``height`` [m] above the object, opens them, and grasps.

    The first two strokes approach and descend, the first two of the gripper open and close. What begins after
    the grasp comes ``retry`` [s] later.
    """
    approach, descent, *_ = arm.tool
    opening, closing, *_ = arm.gripper
    x, y, z, *angles = descent.target
    too_high = replace(descent, target=(x, y, z + height, *angles))
    reopening = Stroke(closing.end + 0.15, closing.end + 0.55, opening.target)
    further_down = Stroke(max(descent.end + 0.35, reopening.start + 0.1), descent.end + retry, descent.target)
    after = delayed(ArmScript(arm.tool[2:], arm.gripper[1:]), retry, -np.inf)
    return ArmScript(
        tool=(approach, too_high, further_down, *after.tool),
        gripper=(opening, closing, reopening, *after.gripper),
    )


def delayed(arm: ArmScript, delay: float, after: float) -> ArmScript:
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
    period: float,
    window: float = PAUSE_WINDOW,
) -> np.ndarray:
    """Moments of the script [s] at which the control steps fall.

    Args:
        span: first and last moment of the script [s].
        pauses: moments of the script [s] at which to linger, and for how long [s].
        speed: pace of the script; or its pace at each of ``fine_moments(span, period)``.
        period: time between two control steps [s].
        window: stretch [s] of the script over which each pause is spread; at 0 the script stands still.

    Returns:
        (T,), increasing, from the first moment to the last.
    """
    script = fine_moments(span, period)
    wall = _elapsed(script, speed) if isinstance(speed, np.ndarray) else (script - span[0]) / speed
    for moment, dwell in pauses:
        share = minimum_jerk((script - moment) / window + 0.5) if window else script > moment
        wall = wall + dwell * share
    steps = np.arange(0.0, wall[-1] + 1e-9, period)
    return np.interp(steps, wall, script)


def fine_moments(span: tuple[float, float], period: float) -> np.ndarray:
    """Moments of the script [s], four to a control period."""
    return np.arange(span[0], span[1] + 1e-9, period / 4)


def _elapsed(script: np.ndarray, speed: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(np.diff(script) / speed[1:])])


def step_times(
    script: Timing, options: ExpertOptions, rng: np.random.Generator, *, period: float, most_steps: int
) -> np.ndarray:
    """Moments of the script [s] at which the control steps of one episode fall, with its rests and pauses.

    Args:
        script: when things happen.
        options: pace, pauses and rests.
        rng: of what is uneven.
        period: time between two control steps [s].
        most_steps: control steps of an episode.

    Raises:
        ConfigurationError: an even pace and even pauses that do not fit an episode.
    """
    begin = script.beginning if options.idle_start else 0.0
    span = (begin, script.end if options.idle_end else script.duration)
    moments = fine_moments(span, period)
    speed = options.speed
    if options.pace_change:
        speed = speed * wandering_pace(moments, options.pace_change, rng)
    pauses = [(moment, options.pause(options.dwell, rng)) for moment in script.pauses]
    pauses += [(moment, options.pause(options.dwell_after, rng)) for moment in script.pauses_after]
    window = 0.0 if options.constant_speed else PAUSE_WINDOW
    moving = script_times(span, pauses, speed, period=period, window=window)
    if options.pace_change or options.dwell_spread:
        moving = moving[:most_steps]  # who takes too long this time does not get to the end
    if len(moving) > most_steps:
        raise ConfigurationError(
            f"speed={options.speed} and dwell={options.dwell} make a plan of {len(moving)} steps, an episode "
            f"has {most_steps}; raise the speed or shorten the dwell"
        )
    before, after = (round(rest / period) for rest in (options.idle_start, options.idle_end))
    before = min(before, most_steps - len(moving))
    after = min(after, most_steps - len(moving) - before)
    return np.concatenate([np.full(before, moving[0]), moving, np.full(after, moving[-1])])


def executed(
    actions: np.ndarray,
    arm: Sequence[int],
    options: ExpertOptions,
    rng: np.random.Generator,
    *,
    period: float,
) -> np.ndarray:
    """Commands (T, A) that are executed for recorded actions (T, A): disturbed, and late.

    The disturbance is as in DART (Laskey et al. 2017): the recorded action always leads back from it.

    Args:
        actions: clean targets.
        arm: which of the numbers are disturbed.
        options: noise and latency.
        rng: of the noise; nothing is drawn without any.
        period: time between two control steps [s].
    """
    commands = actions.copy()
    if options.action_noise > 0:
        commands[:, arm] += correlated_noise(
            (len(actions), len(arm)), options.action_noise, rng, period=period
        )
    # Until the first command comes, the robot stays.
    delay = round(options.latency / period)
    return commands[np.maximum(np.arange(len(commands)) - delay, 0)]
