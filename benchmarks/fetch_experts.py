"""Success of the scripted Fetch experts over unseen seeds, as they come and with each option at its limit.

    python benchmarks/fetch_experts.py

Every episode is played as the recorder would. Prints a table for docs/guides/robotics.md.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import track
from rich.table import Table

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.envs.demonstration import ExpertOptions
from lerobot_act_chunking.envs.robotics.experts import EXPERTS, RANGES
from lerobot_act_chunking.recording import RecordSpec

FIRST_SEED = 1_000_000  # far from the seeds anybody records or evaluates with


def options() -> Iterator[ExpertOptions]:
    """As they come, then one option at a time at its limits."""
    usual = asdict(ExpertOptions())
    yield ExpertOptions()
    for name, (low, high, _) in RANGES.items():
        yield from (ExpertOptions(**{**usual, name: value}) for value in (low, high) if value != usual[name])


def measure(task: str, expert: ExpertOptions, episodes: int) -> dict[str, Any]:
    """How many episodes succeed: at their last step, and at any."""
    source = RecordSpec("local/expert", env="gymnasium_robotics", task=task, expert=expert).source()
    changed = {
        name: value for name, value in asdict(expert).items() if value != asdict(ExpertOptions())[name]
    }
    what = f"{task} {changed or ''}"
    with source.open() as play:
        played = [play(seed) for seed in track(range(FIRST_SEED, FIRST_SEED + episodes), what)]
    return {
        "task": task,
        "options": changed,
        "episodes": episodes,
        "final": sum(episode.details["success_final"] for episode in played),
        "any": sum(episode.details["success_any"] for episode in played),
        "failed_seeds": [episode.seed for episode in played if not episode.success],
    }


def table(rows: list[dict[str, Any]]) -> Table:
    shown = Table("task", "options", "final, % [95 % Wilson]", "any, %")
    for row in rows:
        final, episodes = SuccessRate(row["final"], row["episodes"]), row["episodes"]
        low, high = final.interval
        asked = ", ".join(f"{name} {value:g}" for name, value in row["options"].items())
        rate = f"{100 * final.rate:.1f} [{100 * low:.1f}, {100 * high:.1f}]"
        shown.add_row(row["task"], asked, rate, f"{100 * row['any'] / episodes:.1f}")
    return shown


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tasks", nargs="+", choices=EXPERTS, default=list(EXPERTS))
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/fetch_experts.json"))
    args = parser.parse_args()
    rows = [measure(task, expert, args.episodes) for task in args.tasks for expert in options()]
    Console(width=120).print(table(rows))
    args.out.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
