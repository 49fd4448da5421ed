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
GOOD = 0.9
"""What the present settings must reach: this success for sure, or this share of the leader's."""


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
        settled: whether the present settings are so good that the others were not tried.
        complete: whether there was time for all that was planned.
    """

    candidates: Sequence[C]
    level: float
    results: dict[C, list[bool]] = field(default_factory=dict)
    dropped: dict[C, int] = field(default_factory=dict)
    settled: bool = False
    complete: bool = True

    @property
    def running(self) -> list[C]:
        """Those that were measured and not given up, the best on the episodes that all of them ran first."""
        alive = [each for each in self.candidates if self.results[each] and each not in self.dropped]
        common = min((len(self.results[each]) for each in alive), default=0)
        return sorted(alive, key=lambda each: (-sum(self.results[each][:common]), -self.rate(each).rate))

    @property
    def leader(self) -> C:
        """The best of them."""
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

    The present settings run two rounds first: where they nearly always succeed there is nothing to search
    for. After each round those that are worse than the leader are given up, at most the worse half at once.

    Args:
        candidates: different ones, the present settings first.
        evaluate: runs episodes.
        episodes: the most for each candidate.
    """
    rounds = rounds_up_to(episodes)
    found = Race(candidates, ALPHA / max(1, len(candidates) - 1) / len(rounds))
    found.results.update({each: [] for each in candidates})
    spans = [(start, total - start) for start, total in zip([0, *rounds], rounds, strict=False)]
    found.complete = _run(found, [Cell(candidates[0], *span) for span in spans[:2]], evaluate)
    found.settled = found.complete and found.rate(candidates[0]).interval[0] >= GOOD
    contenders = list(candidates)
    for number, (start, n) in enumerate(spans, 1):
        if not found.complete or found.settled or len(contenders) == 1:
            break
        cells = [Cell(each, start, n) for each in contenders if len(found.results[each]) == start]
        found.complete = _run(found, cells, evaluate)
        if found.complete:
            _drop(found, number)
            contenders = found.running
    return found


def _run[C: Hashable](found: Race[C], cells: list[Cell[C]], evaluate: Evaluate[C]) -> bool:
    """Take in what these cells give; whether all did."""
    outcomes = sorted(evaluate(cells), key=lambda outcome: outcome[0].start)
    for cell, successes in outcomes:
        if cell.start == len(found.results[cell.candidate]):
            found.results[cell.candidate].extend(successes)
    return len(outcomes) == len(cells)


def _drop(found: Race, number: int) -> None:
    running = found.running
    worse = [each for each in running[1:] if found.is_worse(each, running[0])]
    most = len(running) // 2
    found.dropped.update(dict.fromkeys(worse[len(worse) - min(most, len(worse)) :], number))
