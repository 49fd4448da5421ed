"""Whether it is known by now which policy is best; pure: it knows policies by what they did."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import comb

from lerobot_act_chunking.diagnostics.core.statistics import e_values

LEVEL = 0.05
"""Chance of ever calling one of equal policies better, however often one looks."""


@dataclass(frozen=True)
class Decision:
    """What is known after some episodes.

    Attributes:
        best: the policy with most successes.
        e_values: the best's against each other, the largest since the first episode.
        needed: e-value that decides: one over the level, times the number of comparisons.
        episodes: that each has done.
        most: episodes that each might do.
    """

    best: str
    e_values: dict[str, float]
    needed: float
    episodes: int
    most: int

    @property
    def decided(self) -> bool:
        """Whether the best is better than each other."""
        return min(self.e_values.values()) >= self.needed


def decide(outcomes: Mapping[str, Sequence[bool]], most: int) -> Decision:
    """How sure it is which policy is best.

    Each two are a bet of their own against equal success rates (`Pairs.e_value`), and whoever looks after
    every episode wins one over `LEVEL` times the stake with a chance of at most `LEVEL`, over all bets.

    Args:
        outcomes: of two policies or more, whether each episode succeeded, in the same order.
        most: episodes that each might do.
    """
    best = max(outcomes, key=lambda name: sum(outcomes[name]))
    largest = {
        name: float(e_values(outcomes[best], outcome).max())
        for name, outcome in outcomes.items()
        if name != best
    }
    return Decision(best, largest, comb(len(outcomes), 2) / LEVEL, len(outcomes[best]), most)
