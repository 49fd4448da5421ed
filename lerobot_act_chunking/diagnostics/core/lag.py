"""How long after the command the robot moves, and whether there is anything to be said about it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from lerobot_act_chunking.diagnostics.core.trajectories import JITTER_HZ, Trajectories, UndefinedMeasureError

MAX_LAG_SECONDS = 2.0
"""Delays up to here are looked for unless told otherwise, as far as half an episode allows."""
BEFORE_SECONDS = 0.5
"""How far the motion may be before the command; then it is no answer to it."""
LEAST_CORRELATION = 0.5
BY_CHANCE = 3.5
"""Standard errors of a correlation between unrelated motions that a likeness must exceed."""
ALWAYS_ENOUGH = 0.9
"""Correlation that is enough of motions so slow or periodic that chance cannot be told."""
AS_GOOD = 0.02
"""Correlation by which a later peak must be better: periodic motion has many that are alike."""
APART_STEPS = 1.5
"""Control steps between lags from which joints form groups of their own."""
MADE_FROM_STATES = 0.99
"""Share of the steps in which the action is a later state, from which nobody commanded anything."""
LATEST_STATE = 3
GAUSSIAN_CUTOFF = math.sqrt(math.log(2)) / (2 * math.pi)
"""Standard deviation in time times -3 dB frequency of a Gaussian low-pass."""


@dataclass(frozen=True)
class Lag:
    """Delay of a motion behind its command [s], and the correlation of their velocities there."""

    seconds: float
    correlation: float


@dataclass(frozen=True)
class LagProducts:
    """Sums over time of command and motion velocities, ``(L, D)`` each, for L delays.

    Attributes:
        first: delay of the first row, in control steps; negative.
        chance: variance ``(D,)`` of the correlation of unrelated motions that change as slowly as these.
    """

    dt: float
    first: int
    products: np.ndarray
    commanded: np.ndarray
    achieved: np.ndarray
    chance: np.ndarray

    def lag(self, dims: Sequence[int]) -> Lag:
        """Delay after which the motion of some dimensions resembles the command most.

        The first peak of the velocities' normalised cross-correlation among those that are as high as any,
        refined between samples by a parabola. Positions are those at which the command was given, so a robot
        that arrives within the same control period lags by one period. Only motion below about 5 Hz counts:
        jitter passes through a robot with another delay than the motion it sits on.

        Raises:
            UndefinedMeasureError: nothing moves; or what is found is no more than chance, or no answer.
        """
        commanded, achieved = self.commanded[:, dims].sum(1), self.achieved[:, dims].sum(1)
        known = (commanded > 0) & (achieved > 0)
        if not known.any():
            raise UndefinedMeasureError("there is no command, or no motion")
        power = np.sqrt(np.where(known, commanded * achieved, 1.0))
        correlation = np.where(known, self.products[:, dims].sum(1) / power, -1.0)
        by_chance = BY_CHANCE * float(np.sqrt(self.chance[list(dims)].max()))
        least = min(max(LEAST_CORRELATION, by_chance), ALWAYS_ENOUGH)
        best = _first_peak(correlation, -self.first)
        if correlation[best] < least:
            raise UndefinedMeasureError(
                f"motion and command do not resemble each other: correlation {correlation[best]:.2f} at "
                f"best, {least:.2f} needed; searched up to {self.reach:.2g} s"
            )
        if best in (0, len(correlation) - 1):
            raise UndefinedMeasureError(
                f"motion and command resemble each other most at {(best + self.first) * self.dt:.2g} s, "
                "where the search ends: the lag may be beyond it"
            )
        if best + self.first < 0:
            raise UndefinedMeasureError(
                "the motion comes before the command: the actions were made from the states"
            )
        steps = best + self.first + _refined(correlation[best - 1 : best + 2])
        return Lag(max(0.0, steps) * self.dt, float(correlation[best]))

    @property
    def reach(self) -> float:
        """Longest delay looked for [s]."""
        return (self.first + len(self.products) - 1) * self.dt


def lag_products(
    commands: Trajectories, positions: Trajectories, dt: float, reach_s: float = MAX_LAG_SECONDS
) -> LagProducts:
    """What `LagProducts.lag` needs, over all episodes.

    Args:
        commands: ``(T, D)`` each.
        positions: the same of what the robot did.
        dt: control period [s].
        reach_s: longest delay to look for [s].
    """
    longest = max(len(command) for command in commands)
    most = max(2, int(min(reach_s / dt, longest // 2)))
    first = -min(max(2, int(BEFORE_SECONDS / dt)), most)
    sigma = GAUSSIAN_CUTOFF / JITTER_HZ / dt
    sums = np.zeros((3, most - first + 1, commands[0].shape[1]))
    auto = np.zeros((2, most + 1, commands[0].shape[1]))
    samples = 0
    for command, position in zip(commands, positions, strict=True):
        commanded, achieved = (
            ndimage.gaussian_filter1d(np.diff(motion, axis=0), sigma, axis=0)
            for motion in (command, position)
        )
        samples += len(commanded)
        for row, lag in enumerate(range(first, most + 1)):
            early, late = _shifted(commanded, achieved, lag)
            sums[:, row] += (early * late).sum(0), np.square(early).sum(0), np.square(late).sum(0)
        for lag in range(most + 1):
            auto[:, lag] += _autoproduct(commanded, lag), _autoproduct(achieved, lag)
    return LagProducts(dt, first, *sums, chance=_chance(auto, samples))


@dataclass(frozen=True)
class LagGroup:
    """Joints that lag alike: the shortest and the longest lag of them [s]."""

    joints: list[str]
    shortest_s: float
    longest_s: float


def group_lags(lags: dict[str, Lag], dt: float) -> list[LagGroup]:
    """Joints by lag, the shortest first; a gap of more than ``APART_STEPS`` control steps parts them."""
    ordered = sorted(lags, key=lambda joint: lags[joint].seconds)
    groups: list[list[str]] = []
    for joint in ordered:
        if groups and lags[joint].seconds - lags[groups[-1][-1]].seconds <= APART_STEPS * dt:
            groups[-1].append(joint)
        else:
            groups.append([joint])
    return [LagGroup(each, lags[each[0]].seconds, lags[each[-1]].seconds) for each in groups]


def made_from_states(commands: Trajectories, positions: Trajectories, dims: Sequence[int]) -> int | None:
    """How many steps later the state is the action itself, to the bit; None if it is at no such time.

    Only steps at which something moves count, or a robot that rests would always look like that.
    """
    for later in range(LATEST_STATE + 1):
        pairs = [
            (command[: len(command) - later][:, dims], position[later:][:, dims])
            for command, position in zip(commands, positions, strict=True)
            if len(command) > later + 1
        ]
        if not pairs or not len(dims):
            return None
        moved = np.concatenate(
            [np.diff(position, axis=0, prepend=position[:1]).any(1) for _, position in pairs]
        )
        same = np.concatenate([(command == position).all(1) for command, position in pairs])
        if moved.any() and same[moved].mean() >= MADE_FROM_STATES:
            return later
    return None


def _shifted(commanded: np.ndarray, achieved: np.ndarray, lag: int) -> tuple[np.ndarray, np.ndarray]:
    size = max(0, len(commanded) - abs(lag))
    if lag >= 0:
        return commanded[:size], achieved[len(achieved) - size :]
    return commanded[len(commanded) - size :], achieved[:size]


def _autoproduct(velocity: np.ndarray, lag: int) -> np.ndarray:
    return (velocity[: max(0, len(velocity) - lag)] * velocity[lag:]).sum(0)


def _chance(auto: np.ndarray, samples: int) -> np.ndarray:
    """Variance (D,) of the correlation of unrelated signals with these autoproducts (Bartlett 1935)."""
    total = np.where(auto[:, :1] > 0, auto[:, :1], 1.0)
    one, other = auto / total
    return np.maximum(1.0, 1.0 + 2.0 * (one[1:] * other[1:]).sum(0)) / samples


def _first_peak(correlation: np.ndarray, zero: int) -> int:
    """The first maximum after no delay that is as high as any; else the highest of all."""
    highest = correlation.max()
    padded = np.concatenate([[-np.inf], correlation, [-np.inf]])
    peaks = np.flatnonzero((correlation >= padded[:-2]) & (correlation >= padded[2:]))
    good = peaks[(peaks >= zero) & (correlation[peaks] >= highest - AS_GOOD)]
    return int(good[0]) if len(good) else int(correlation.argmax())


def _refined(around: np.ndarray) -> float:
    """Position of the maximum between three samples, from the middle one."""
    left, middle, right = around
    bend = left - 2 * middle + right
    return 0.0 if bend == 0 else float(0.5 * (left - right) / bend)
