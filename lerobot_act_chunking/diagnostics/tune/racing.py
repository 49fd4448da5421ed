"""Which candidates are worth more episodes: rounds of successive halving on common seeds.

Pure: it knows candidates by what they are equal to, and episodes by their seeds alone.
"""

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate, mcnemar

FIRST_ROUND = 25
"""Episodes of the first round; each further one doubles them."""
ALPHA = 0.05
"""Chance of ever dropping a candidate that is as good as the leader; split over candidates and rounds."""


@dataclass(frozen=True)
class Cell[C: Hashable]:
    """Episodes of one candidate that run together: ``n`` seeds from the race's first + ``start`` on."""

    candidate: C
    start: int
    n: int


type Evaluate[C: Hashable] = Callable[[Sequence[Cell[C]]], Iterator[tuple[Cell[C], Sequence[bool]]]]
"""Runs cells, in any order, and hands out which episodes succeeded; ends early where time is over."""


@dataclass
class Race[C: Hashable]:
    """What is known of all candidates.

    Attributes:
        candidates: all, the present settings first.
        level: below which p-value one comparison counts.
        results: successes of each candidate, by episode; all begin with the same seed.
        dropped: the round, from 1 on, after which a candidate was given up.
        complete: whether all episodes that were planned were run.
    """

    candidates: Sequence[C]
    level: float
    results: dict[C, list[bool]] = field(default_factory=dict)
    dropped: dict[C, int] = field(default_factory=dict)
    complete: bool = True

    @property
    def running(self) -> list[C]:
        """Those that were measured and not given up, the best first; of equals the one that came first."""
        alive = [each for each in self.candidates if self.results.get(each) and each not in self.dropped]
        most = max((len(self.results[each]) for each in alive), default=0)
        return sorted(alive, key=lambda each: (len(self.results[each]) < most, -self.rate(each).rate))

    @property
    def leader(self) -> C:
        """The best of those with most episodes."""
        return self.running[0]

    @property
    def n_episodes(self) -> int:
        """Of all candidates."""
        return sum(map(len, self.results.values()))

    def rate(self, candidate: C) -> SuccessRate:
        """Successes of one candidate."""
        successes = self.results[candidate]
        return SuccessRate(sum(successes), len(successes))

    def both(self, candidate: C, other: C) -> tuple[int, int]:
        """Successes of two candidates on the episodes that both ran."""
        pairs = list(zip(self.results[candidate], self.results[other], strict=False))
        return sum(first for first, _ in pairs), sum(second for _, second in pairs)

    def p_value(self, candidate: C, other: C) -> float:
        """Of the exact McNemar test on the episodes that both ran, for this one comparison."""
        pairs = list(zip(self.results[candidate], self.results[other], strict=False))
        failed = [at for at, (success, _) in enumerate(pairs) if not success]
        failed_other = [at for at, (_, success) in enumerate(pairs) if not success]
        return mcnemar(failed, failed_other)

    def is_worse(self, candidate: C, other: C) -> bool:
        """Whether a candidate is worse than another beyond what all comparisons together let chance do."""
        ours, theirs = self.both(candidate, other)
        return ours < theirs and self.p_value(candidate, other) < self.level


def rounds_up_to(episodes: int) -> list[int]:
    """Episodes of each candidate after every round: 25, 50, 100, ..., ``episodes``."""
    totals, total = [], FIRST_ROUND
    while total < episodes:
        totals.append(total)
        total *= 2
    return [*totals, episodes]


def race[C: Hashable](candidates: Sequence[C], evaluate: Evaluate[C], episodes: int) -> Race[C]:
    """Run the candidates against each other until one is left, or all episodes are run.

    After each round, those that are worse than the leader are given up, at most the worse half at a time.

    Args:
        candidates: different ones, the present settings first.
        evaluate: runs episodes.
        episodes: the most for each candidate.
    """
    rounds = rounds_up_to(episodes)
    found = Race(candidates, ALPHA / max(1, len(candidates) - 1) / len(rounds))
    found.results.update({each: [] for each in candidates})
    contenders, start = list(candidates), 0
    for number, total in enumerate(rounds, 1):
        cells = [Cell(each, start, total - start) for each in contenders]
        for cell, successes in evaluate(cells):
            found.results[cell.candidate].extend(successes)
        if any(len(found.results[each]) < total for each in contenders):
            found.complete = False
            return found
        _drop(found, number)
        contenders, start = found.running, total
        if len(contenders) == 1:
            return found
    return found


def _drop(found: Race, number: int) -> None:
    running = found.running
    worse = [each for each in running[1:] if found.is_worse(each, running[0])]
    most = len(running) // 2
    found.dropped.update(dict.fromkeys(worse[len(worse) - min(most, len(worse)) :], number))
