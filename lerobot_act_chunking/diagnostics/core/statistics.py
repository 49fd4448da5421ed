"""What finite numbers of episodes say of a success rate, and of the difference between two."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

BETA = 2.0  # both parameters of how a bet is spread over the shares
LARGEST_LOG = 700.0  # what still is a number as e to the power of it


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
    def exact_interval(self) -> tuple[float, float]:
        """Ends of the 95 % Clopper-Pearson interval, in [0, 1]: never too narrow, also near 0 and 1."""
        from scipy.stats import binomtest

        low, high = binomtest(self.successes, self.episodes).proportion_ci(method="exact")
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
    only_here, only_there = set(failed) - set(failed_other), set(failed_other) - set(failed)
    differing = len(only_here) + len(only_there)
    return Pairs(0, len(only_there), len(only_here), 0).p_value if differing else 1.0


@dataclass(frozen=True)
class Pairs:
    """Two policies on the same episodes.

    Attributes:
        both: episodes in which both succeeded.
        only_first: those in which only the first one did.
        only_second: those in which only the second one did.
        neither: those in which both failed.

    Raises:
        ValueError: no episode at all.
    """

    both: int
    only_first: int
    only_second: int
    neither: int

    def __post_init__(self) -> None:
        if self.n == 0:
            raise ValueError("no common episode to compare by")

    @classmethod
    def of(cls, first: Sequence[bool], second: Sequence[bool]) -> "Pairs":
        """Which of the same episodes, in the same order, two policies did."""
        both = list(zip(first, second, strict=True))
        return cls(*map(both.count, ((True, True), (True, False), (False, True), (False, False))))

    @property
    def n(self) -> int:
        """The number of episodes."""
        return self.both + self.only_first + self.only_second + self.neither

    @property
    def difference(self) -> float:
        """The first one's success rate minus the second one's."""
        return (self.only_first - self.only_second) / self.n

    @property
    def p_value(self) -> float:
        """Of the exact McNemar test (McNemar 1947), two-sided."""
        from scipy.stats import binomtest

        differing = self.only_first + self.only_second
        return float(binomtest(self.only_first, differing).pvalue) if differing else 1.0

    @property
    def e_value(self) -> float:
        """What a bet against equal success rates has made of one unit, episode by episode.

        If the rates are equal, half of the episodes that tell the two apart go to each. The bet is spread
        over all other shares by a Beta(2, 2) distribution (the mixture of Robbins 1970; Ramdas et al. 2023 on
        betting). 20 or more then has a probability of 5 % at most, whenever one looks and however often. So
        episodes may be added until it is decided, which a p-value does not allow.
        """
        return float(_e_values(np.array(self.only_first), np.array(self.only_second)))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the difference (Newcombe 1998, paired, method 10)."""
        first = SuccessRate(self.both + self.only_first, self.n)
        second = SuccessRate(self.both + self.only_second, self.n)
        return newcombe(first, second, self._correlation)

    @property
    def _correlation(self) -> float:
        """Of success in the two, with Newcombe's correction for continuity; 0 where one never varies."""
        a, b, c, d = self.both, self.only_first, self.only_second, self.neither
        scale = (a + b) * (c + d) * (a + c) * (b + d)
        product = a * d - b * c
        product = max(product - self.n / 2, 0) if product > 0 else product
        return product / math.sqrt(scale) if scale else 0.0


def e_values(first: Sequence[bool], second: Sequence[bool]) -> np.ndarray:
    """`Pairs.e_value` after each of the same episodes, where the first is ahead; 0 where it is not.

    Args:
        first: which episodes (n,) one policy did, in the order in which they ran.
        second: which the other did.

    Returns:
        (n,): 20 or more at any of them decides for the first; if it is no better, with a chance of 5 %.
    """
    one, other = np.array(first, bool), np.array(second, bool)
    only_first, only_second = np.cumsum(one & ~other), np.cumsum(other & ~one)
    return np.where(only_first > only_second, _e_values(only_first, only_second), 0.0)


def _e_values(only_first: np.ndarray, only_second: np.ndarray) -> np.ndarray:
    from scipy.special import betaln

    bets = betaln(only_first + BETA, only_second + BETA) - betaln(BETA, BETA)
    return np.exp(np.minimum(bets + (only_first + only_second) * math.log(2), LARGEST_LOG))


def newcombe(first: SuccessRate, second: SuccessRate, correlation: float = 0.0) -> tuple[float, float]:
    """95 % interval of the difference first - second of two rates, from their Wilson intervals.

    Newcombe (1998): method 10 of the paper on independent rates, or of that on paired ones.

    Args:
        first: successes of one policy.
        second: successes of the other.
        correlation: of both in the same episodes; 0 if they ran others.
    """
    (low, high), (other_low, other_high) = first.interval, second.interval
    down, up = first.rate - low, high - first.rate
    other_down, other_up = second.rate - other_low, other_high - second.rate
    difference = first.rate - second.rate

    def reach(one: float, other: float) -> float:
        return math.sqrt(max(0.0, one**2 - 2 * correlation * one * other + other**2))

    return difference - reach(down, other_up), difference + reach(up, other_down)


def holm(p_values: Sequence[float]) -> list[float]:
    """P-values that may be read together (Holm 1979): the error of all of them is at most what each shows."""
    adjusted, least = [1.0] * len(p_values), 0.0
    for rank, index in enumerate(sorted(range(len(p_values)), key=lambda each: p_values[each])):
        least = max(least, min(1.0, p_values[index] * (len(p_values) - rank)))
        adjusted[index] = least
    return adjusted


def letters(count: int, differ: Collection[tuple[int, int]]) -> list[str]:
    """Letters such that two share one exactly if they do not differ (Piepho 2004, insert and absorb).

    Args:
        count: how many there are, the first with the first letter.
        differ: pairs of indices that surely differ.
    """
    columns = [set(range(count))]
    for pair in differ:
        for column in [each for each in columns if each.issuperset(pair)]:
            columns.remove(column)
            columns += [column - {index} for index in pair]
        columns = [
            column
            for place, column in enumerate(columns)
            if not any(
                column < other or (column == other and place > before) for before, other in enumerate(columns)
            )
        ]
    columns.sort(key=sorted)
    return [
        "".join(chr(ord("a") + place) for place, column in enumerate(columns) if index in column)
        for index in range(count)
    ]
