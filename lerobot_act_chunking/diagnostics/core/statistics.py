"""What finite numbers of episodes say of a success rate, and of the difference between two."""

from collections.abc import Collection
from dataclasses import dataclass


@dataclass(frozen=True)
class SuccessRate:
    """Successes out of independent episodes, with a 95 % Wilson score interval (Wilson 1927).

    Raises:
        ValueError: more successes than episodes, or no episode at all.
    """

    successes: int
    episodes: int

    def __post_init__(self) -> None:
        if not 0 <= self.successes <= self.episodes or self.episodes == 0:
            raise ValueError(f"{self.successes} successes in {self.episodes} episodes is no success rate")

    @property
    def rate(self) -> float:
        """The share of successful episodes, in [0, 1]."""
        return self.successes / self.episodes

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper end of the 95 % Wilson interval, in [0, 1]."""
        from scipy.stats import binomtest  # half a second of import that --help should not pay

        low, high = binomtest(self.successes, self.episodes).proportion_ci(method="wilson")
        return float(low), float(high)

    @property
    def percent(self) -> str:
        """The interval in per cent, as ``30.1-95.4``."""
        low, high = self.interval
        return f"{100 * low:.1f}-{100 * high:.1f}"

    def __str__(self) -> str:
        return (
            f"{100 * self.rate:.1f} % ({self.successes}/{self.episodes} episodes, "
            f"95 % Wilson interval {self.percent} %)"
        )


def mcnemar(failed: Collection[int], failed_other: Collection[int]) -> float:
    """The p-value of the exact McNemar test (McNemar 1947), two-sided.

    Could equal success rates explain the difference between two policies that ran the same episodes?

    Args:
        failed: the episodes in which one failed, by their seeds.
        failed_other: those in which the other did.
    """
    from scipy.stats import binomtest

    only_here = len(set(failed) - set(failed_other))
    only_there = len(set(failed_other) - set(failed))
    differing = only_here + only_there
    return float(binomtest(only_here, differing).pvalue) if differing else 1.0
