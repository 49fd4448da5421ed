"""What is executed at the demonstrator's observations: when grippers switch, and who stands still."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_act_chunking.diagnostics.core.stillness import IDLE, PAUSE_S, find_stillness

OPEN, CLOSED = 2 / 3, 1 / 3
"""Shares of a gripper's range, beyond which it is open or closed."""
APART_S = 2.0
"""Most time between a demonstrated and an executed switch that belong together [s]."""
MOVES = 5 * IDLE  # of the demonstrator's peak speed: beyond doubt in motion


@dataclass(frozen=True)
class Gripper:
    """When one gripper dimension opens and closes.

    Attributes:
        name: of the dimension.
        demonstrated: number of switches.
        delays_s: of the policy's switch behind the demonstrated one, where there are both [s].
        missed: demonstrated switches without one of the policy within 2 s.
        extra: the policy's, without a demonstrated one.
    """

    name: str
    demonstrated: int
    delays_s: tuple[float, ...]
    missed: int
    extra: int


@dataclass(frozen=True)
class Hesitations:
    """Of all frames, within rests of half a second and more.

    Attributes:
        policy_rests: share in which the policy stands still and the demonstrator moves.
        demonstrator_rests: the reverse.
        longest_s: the longest such rest of the policy [s].
    """

    policy_rests: float
    demonstrator_rests: float
    longest_s: float


def time_gripper(
    name: str,
    pairs: Sequence[tuple[np.ndarray, np.ndarray]],
    span: tuple[float, float],
    fps: float,
) -> Gripper:
    """Compare the switches of one dimension.

    Args:
        name: of the dimension.
        pairs: what was executed (L,) and what was demonstrated (L,), of each episode.
        span: closed and open, or the reverse.
        fps: control steps per second.
    """
    demonstrated, delays, extra = 0, [], 0
    for executed, done in pairs:
        theirs, ours = switches(done, span), switches(executed, span)
        demonstrated += len(theirs)
        for at, direction in theirs:
            same = [each for each in ours if each[1] == direction and abs(each[0] - at) <= APART_S * fps]
            if same:
                found = min(same, key=lambda each: abs(each[0] - at))
                ours.remove(found)
                delays.append((found[0] - at) / fps)
        extra += len(ours)
    return Gripper(name, demonstrated, tuple(delays), demonstrated - len(delays), extra)


def switches(values: np.ndarray, span: tuple[float, float]) -> list[tuple[int, bool]]:
    """Steps at which a dimension (L,) reaches the other end third of its span, and whether that is up."""
    share = (values - span[0]) / (span[1] - span[0])
    ends = np.flatnonzero((share >= OPEN) | (share <= CLOSED))
    up = share[ends] >= OPEN
    turns = np.flatnonzero(np.diff(up.astype(int))) + 1
    return [(int(ends[turn]), bool(up[turn])) for turn in turns]


def find_hesitations(
    pairs: Sequence[tuple[np.ndarray, np.ndarray]], scale: np.ndarray, fps: float
) -> Hesitations:
    """Who stands still where the other moves.

    Args:
        pairs: what was executed (L, D) and what was demonstrated (L, D), of each episode.
        scale: (D,) standard deviations.
        fps: control steps per second.
    """
    ours, theirs = [], []
    for executed, done in pairs:
        policy, person = (find_stillness(rows, scale, fps).speed for rows in (executed, done))
        peak = person.max(initial=0.0)
        ours += _runs((policy <= IDLE * peak) & (person > MOVES * peak), fps)
        theirs += _runs((person <= IDLE * peak) & (policy > MOVES * peak), fps)
    frames = sum(len(done) for _, done in pairs)
    return Hesitations(sum(ours) / frames, sum(theirs) / frames, max(ours, default=0) / fps)


def _runs(mask: np.ndarray, fps: float) -> list[int]:
    """Lengths of the runs of half a second and more."""
    edges = np.flatnonzero(np.diff(mask.astype(int), prepend=0, append=0)).reshape(-1, 2)
    lengths = (int(end - begin) for begin, end in edges)
    return [steps for steps in lengths if steps >= PAUSE_S * fps]
