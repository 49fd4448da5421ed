"""How often `act-chunking eval --until=decided` errs, and what it saves.

    python benchmarks/sequential.py

Two policies do up to 200 common episodes, 25 at a time, and the comparison ends as soon as it is decided, by
the same code as the command's. Success is drawn: an episode's difficulty is shared by both to some degree
(a Gaussian copula with this correlation), as common seeds make it. 10 000 comparisons for each row, without a
simulator; the results are in benchmarks/results/sequential.json, and as a table in
docs/instruments/eval.md (a test compares).
"""

import argparse
import json
import re
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.stats import norm

from lerobot_act_chunking.diagnostics.core.statistics import mcnemar
from lerobot_act_chunking.diagnostics.eval.deciding import LEVEL, decide

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results" / "sequential.json"
PAGE = ROOT / "docs" / "instruments" / "eval.md"
MARK = "<!-- sequential: python benchmarks/sequential.py -->"
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


def with_table(text: str) -> str:
    """The page with the table as the results have it."""
    lines = [
        "| success rates | correlation | decided | wrongly | by a test of 200 | median episodes | saved |",
        "|---|---|---|---|---|---|---|",
        *(line(Row(**each)) for each in json.loads(RESULTS.read_text())),
    ]
    table = "\n".join(lines)
    return re.sub(rf"({re.escape(MARK)}\n).*?(<!-- end -->)", rf"\1\n{table}\n\n\2", text, flags=re.DOTALL)


def line(row: Row) -> str:
    """A row of the table."""
    shares = [f"{100 * count / row.comparisons:.1f} %" for count in (row.decided, row.wrong, row.fixed)]
    saved = f"{100 * (1 - row.median_episodes / EPISODES):.0f} %"
    cells = [f"{100 * row.first:g} and {100 * row.second:g} %", f"{row.correlation:g}", *shares]
    return "| " + " | ".join([*cells, f"{row.median_episodes:g}", saved]) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--comparisons", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    rows = []
    for each in EQUAL + APART:
        rows.append(simulate(*each, args.comparisons, rng))
        print(line(rows[-1]), flush=True)
    RESULTS.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")
    PAGE.write_text(with_table(PAGE.read_text()))


if __name__ == "__main__":
    main()
