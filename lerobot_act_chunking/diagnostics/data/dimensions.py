"""What single dimensions do: stand at an end, leap, open and close; and rows that repeat."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_act_chunking.data.dimension_names import is_hand
from lerobot_act_chunking.diagnostics.core.noise_floor import SWITCH, NoiseFloor

OPEN, CLOSED = 2 / 3, 1 / 3
"""Shares of a hand's range in an episode beyond which it counts as open or closed."""


@dataclass(frozen=True)
class Behaviour:
    """Of one dimension over all episodes.

    Attributes:
        name: of the dimension.
        kind: ``moves``, ``noise`` or ``constant``, as by the noise floor.
        hand: whether it belongs to a hand or gripper, by its name, or leaps like one.
        low: least value [raw units].
        high: greatest.
        std: standard deviation.
        at_low: share of the frames that stand exactly there.
        at_high: the same at the greatest value.
        jumps: (episode, frame) before each change of more than a fifth of the range.
        events: median number of openings and closings in an episode; None of what is no hand.
    """

    name: str
    kind: str
    hand: bool
    low: float
    high: float
    std: float
    at_low: float
    at_high: float
    jumps: tuple[tuple[int, int], ...]
    events: float | None

    @property
    def moves(self) -> bool:
        """Whether it does, above its noise."""
        return self.kind == "moves"

    @property
    def at_an_end(self) -> tuple[float, float]:
        """The value among the least and the greatest at which it stands more often, and how often."""
        return (self.low, self.at_low) if self.at_low > self.at_high else (self.high, self.at_high)


@dataclass(frozen=True)
class Repeats:
    """Rows that equal the one before in all dimensions.

    Attributes:
        share: of all frames.
        in_motion: of the frames that are not idle.
        longest_s: how long one row was repeated at most.
    """

    share: float
    in_motion: float
    longest_s: float


def find_behaviours(
    episodes: Sequence[np.ndarray], indices: Sequence[int], floor: NoiseFloor
) -> list[Behaviour]:
    """What every dimension does.

    Args:
        episodes: (L, D) each.
        indices: of the episodes.
        floor: which dimensions move.
    """
    whole = np.concatenate(episodes)
    low, high = whole.min(0), whole.max(0)
    span = high - low
    jumps = [np.abs(np.diff(rows, axis=0)) > SWITCH * span for rows in episodes]
    found = []
    for dim, each in enumerate(floor.dimensions):
        hand = is_hand(each.name) or each.switches
        still = each.kind == "constant"
        found.append(
            Behaviour(
                name=each.name,
                kind=each.kind,
                hand=hand,
                low=float(low[dim]),
                high=float(high[dim]),
                std=float(whole[:, dim].std()),
                at_low=float((whole[:, dim] == low[dim]).mean()),
                at_high=float((whole[:, dim] == high[dim]).mean()),
                jumps=() if still else _places([rows[:, dim] for rows in jumps], indices),
                events=_events([(rows[:, dim] - low[dim]) / span[dim] for rows in episodes])
                if hand and each.kind == "moves"
                else None,
            )
        )
    return found


def find_repeats(episodes: Sequence[np.ndarray], idle: Sequence[np.ndarray], fps: float) -> Repeats:
    """How often a row equals the one before.

    Args:
        episodes: (L, D) each.
        idle: (L - 1,) each: which steps are.
        fps: frames per second.
    """
    same = [(np.diff(rows, axis=0) == 0).all(1) for rows in episodes]
    busy = np.concatenate([~each for each in idle])
    together = np.concatenate(same)
    return Repeats(
        share=float(together.sum() / sum(map(len, episodes))),
        in_motion=float(together[busy].mean()) if busy.any() else 0.0,
        longest_s=max(map(longest_run, same)) / fps,
    )


def longest_run(flags: np.ndarray) -> int:
    """Length of the longest run of True."""
    edges = np.flatnonzero(np.diff(flags.astype(int), prepend=0, append=0)).reshape(-1, 2)
    return int((edges[:, 1] - edges[:, 0]).max(initial=0))


def _places(jumps: Sequence[np.ndarray], indices: Sequence[int]) -> tuple[tuple[int, int], ...]:
    return tuple(
        (index, int(frame))
        for index, rows in zip(indices, jumps, strict=True)
        for frame in np.flatnonzero(rows)
    )


def _events(episodes: Sequence[np.ndarray]) -> float:
    """Median number of passages between the lower and the upper third of an episode's own range.

    Values are shares of the whole range, of which an episode that uses less than a fifth has none.
    """
    counts = []
    for values in episodes:
        share = np.ptp(values)
        own = (values - values.min()) / share if share > SWITCH else np.zeros(1)
        clear = own[(own >= OPEN) | (own <= CLOSED)]
        counts.append(int(np.count_nonzero(np.diff(clear >= OPEN))))
    return float(np.median(counts))
