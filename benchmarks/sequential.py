"""How often `act-chunking eval --until=decided` errs, and what it saves.

    python benchmarks/sequential.py

Two policies do up to 200 common episodes, 25 at a time, and the comparison ends as soon as it is decided, by
the same code as the command's. Success is drawn: an episode's difficulty is shared by both to some degree
(a Gaussian copula with this correlation), as common seeds make it. 10 000 comparisons for each row, without a
simulator; the results are in benchmarks/results/sequential.json.
"""

import argparse
import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import norm

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate, mcnemar
from lerobot_act_chunking.diagnostics.eval.deciding import LEVEL, decide

EPISODES, GROUP = 200, 25
EQUAL = [(rate, rate, correlation) for rate in (0.5, 0.7, 0.9, 0.97) for correlation in (0.0, 0.5)]
APART = [
    (first, first - difference, correlation)
    for difference in (0.1, 0.2, 0.3)
    for first in (0.6, 0.8, 0.95)
    for correlation in (0.0, 0.5)
]


@dataclass(frozen=True)
class Row:
    """What came of the comparisons of two rates.

    Attributes:
        first: success rate of one policy.
        second: of the other.
        correlation: of an episode's difficulty for both.
        comparisons: how many were simulated.
        decided: how many ended with one of the two called better.
        wrong: how many of these called the wrong one better, or either of two that are equal.
        fixed: how many the exact McNemar test of all 200 episodes decides.
        median_episodes: until the end, of each policy.
        mean_episodes: until the end, of each policy.
    """

    first: float
    second: float
    correlation: float
    comparisons: int
    decided: int
    wrong: int
    fixed: int
    median_episodes: float
    mean_episodes: float


def simulate(
    first: float, second: float, correlation: float, comparisons: int, rng: np.random.Generator
) -> Row:
    """Compare two policies of these rates again and again."""
    ease = rng.standard_normal((comparisons, EPISODES))
    other = correlation * ease + np.sqrt(1 - correlation**2) * rng.standard_normal(ease.shape)
    one, two = ease < norm.ppf(first), other < norm.ppf(second)
    ends, decided, wrong, fixed = [], 0, 0, 0
    for a, b in zip(one.tolist(), two.tolist(), strict=True):
        for end in range(GROUP, EPISODES + 1, GROUP):
            decision = decide({"first": a[:end], "second": b[:end]}, EPISODES)
            if decision.decided:
                break
        ends.append(decision.episodes)
        decided += decision.decided
        wrong += decision.decided and (first == second or decision.best == "second")
        fixed += mcnemar(failures(a), failures(b)) < LEVEL
    return Row(first, second, correlation, comparisons, decided, wrong, fixed, np.median(ends), np.mean(ends))


def failures(outcomes: list[bool]) -> list[int]:
    """Which episodes failed."""
    return [place for place, success in enumerate(outcomes) if not success]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--comparisons", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/sequential.json"))
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    rows = [simulate(*each, args.comparisons, rng) for each in EQUAL + APART]
    table = Table("rates", "correlation", "decided %", "wrong %", "fixed 200 decide %", "median", "saved %")
    for row in rows:
        table.add_row(
            f"{row.first:.2f} and {row.second:.2f}",
            f"{row.correlation:g}",
            f"{100 * row.decided / row.comparisons:.1f}",
            str(SuccessRate(row.wrong, row.comparisons).percent),
            f"{100 * row.fixed / row.comparisons:.1f}",
            f"{row.median_episodes:.0f}",
            f"{100 * (1 - row.median_episodes / EPISODES):.0f}",
        )
    Console(width=120).print(table)
    args.out.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


if __name__ == "__main__":
    main()
