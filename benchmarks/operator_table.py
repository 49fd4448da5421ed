"""The tables of docs/studies/demonstrators.md, from the committed results.

    python benchmarks/operator_table.py

reads benchmarks/results/operators.json, operators_fetch.json and pushed.json and writes the tables between
their marks; a test compares.
"""

import argparse
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
PAGE = ROOT / "docs" / "studies" / "demonstrators.md"
COLUMNS = ("crossfade 25 over 50", "crossfade 25 over 10", "ensemble 25", "open loop")
EVERYBODY, EVERYBODY_COLUMNS = "everybody", ("crossfade 25 over 50", "ensemble 25", "open loop")

NAMES = {
    "act_chunked_history_1500": "`act_chunked`, two observations",
    "act_small_4000": "`act_chunked`, the quickstart's sizes",
}

FETCH_COLUMNS = (
    *(f"receding {interval}" for interval in (2, 4, 6, 10, 12)),
    "open loop",
    "crossfade 6 over 12",
    "ensemble 6",
)


def shown(successes: int, episodes: int) -> str:
    return f"{successes} ({SuccessRate(successes, episodes).percent})"


def by_operator() -> Iterator[str]:
    cells: dict[tuple[str, str, str], dict[str, Any]] = {}
    for entry in json.loads((RESULTS / "operators.json").read_text()):
        if entry["operator"] == EVERYBODY:
            continue
        steps, variant = str(entry["train"]["steps"]), entry["run"]["variant"]
        training = f"{steps}, two observations" if "history" in variant else steps
        cells.setdefault((entry["run"]["task"], entry["operator"], training), {})[entry["execution"]] = entry
    yield f"| task | person | training steps | {' | '.join(COLUMNS)} |"
    yield "|---|---|---|---|---|---|---|"
    for (task, operator, training), row in sorted(cells.items()):
        values = [
            shown(row[name]["episodes"] - len(row[name]["failed_seeds"]), row[name]["episodes"])
            for name in COLUMNS
        ]
        yield f"| {task} | `{operator}` | {training} | {' | '.join(values)} |"


def of_everybody() -> Iterator[str]:
    cells: dict[tuple[str, str, int], dict[str, Any]] = {}
    for entry in json.loads((RESULTS / "operators.json").read_text()):
        if entry["operator"] == EVERYBODY:
            run = entry["run"]
            cells.setdefault((run["task"], run["variant"], run["seed"]), {})[entry["execution"]] = entry
    yield f"| task | policy | training steps | CPU minutes | {' | '.join(EVERYBODY_COLUMNS)} |"
    yield "|" + "---|" * (4 + len(EVERYBODY_COLUMNS))
    for (task, variant, _), row in sorted(cells.items()):
        values = [
            shown(entry["episodes"] - len(entry["failed_seeds"]), entry["episodes"]) if entry else "-"
            for entry in map(row.get, EVERYBODY_COLUMNS)
        ]
        train = next(iter(row.values()))["train"]
        name = NAMES.get(variant) or f"`{variant.rpartition('_')[0]}`"
        yield f"| {task} | {name} | {train['steps']} | {train['cpu_minutes']:.1f} | {' | '.join(values)} |"


def by_interval() -> Iterator[str]:
    entries = json.loads((RESULTS / "operators.json").read_text())
    found = {}
    for entry in entries:
        match = re.fullmatch(r"crossfade (\d+) over 50", entry["execution"])
        if match and (entry["operator"], entry["run"]["task"]) == ("hesitant", "insertion"):
            failed, episodes = len(entry["failed_seeds"]), entry["episodes"]
            found[int(match[1])] = shown(episodes - failed, episodes)
    yield f"| a new chunk every | {' | '.join(f'{interval} steps' for interval in sorted(found))} |"
    yield "|" + "---|" * (len(found) + 1)
    yield f"| successes of 200 | {' | '.join(found[interval] for interval in sorted(found))} |"


def on_fetch() -> Iterator[str]:
    cells: dict[tuple[str, str], dict[str, Any]] = {}
    for entry in json.loads((RESULTS / "operators_fetch.json").read_text()):
        cells.setdefault((entry["run"]["task"], entry["operator"]), {})[entry["execution"]] = entry
    yield f"| task | person | {' | '.join(FETCH_COLUMNS)} |"
    yield "|" + "---|" * (len(FETCH_COLUMNS) + 2)
    for (task, operator), row in sorted(cells.items()):
        values = [
            shown(entry["episodes"] - len(entry["failed_seeds"]), entry["episodes"]) if entry else "-"
            for entry in map(row.get, FETCH_COLUMNS)
        ]
        yield f"| {task} | `{operator}` | {' | '.join(values)} |"


def pushed() -> Iterator[str]:
    entries = json.loads((RESULTS / "pushed.json").read_text())
    yield f"| {' | '.join(entry['execution'] for entry in entries)} |"
    yield "|" + "---|" * len(entries)
    yield f"| {' | '.join(shown(entry['successes'], entry['episodes']) for entry in entries)} |"


def with_tables(text: str) -> str:
    """The page with its tables as the results have them."""
    tables = {
        "operators": by_operator(),
        "everybody": of_everybody(),
        "intervals": by_interval(),
        "pushed": pushed(),
        "fetch": on_fetch(),
    }
    for name, rows in tables.items():
        mark = f"<!-- {name}: python benchmarks/operator_table.py -->"
        table = "\n".join(rows)
        text = re.sub(
            rf"({re.escape(mark)}\n).*?(<!-- end -->)", rf"\1\n{table}\n\n\2", text, flags=re.DOTALL
        )
    return text


def main() -> None:
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    PAGE.write_text(with_tables(PAGE.read_text()))


if __name__ == "__main__":
    main()
