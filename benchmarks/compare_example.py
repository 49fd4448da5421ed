"""The example of docs/instruments/compare.md: evaluations of the study of people as lerobot-eval writes them.

    python benchmarks/compare_example.py outputs/compare

makes a folder with an eval_info.json for each policy of this package that learned `hesitant` or `clumsy`
insertions and acts as it comes, from benchmarks/results/operators.json. Episode i began at seed 1000 + i in
all of them.
"""

import argparse
import json
from pathlib import Path
from typing import Any

from execution_study import FIRST_SEED
from operator_table import DEFAULTS, read

PEOPLE = ("hesitant", "clumsy")


def evaluation(entry: dict[str, Any]) -> dict[str, Any]:
    """What lerobot-eval would have written."""
    failed = {*entry["failed_seeds"]}
    successes = [FIRST_SEED + number not in failed for number in range(entry["episodes"])]
    return {"per_task": [{"task_group": "aloha", "task_id": 0, "metrics": {"successes": successes}}]}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    for entry in read("operators"):
        run = entry["run"]
        asked = entry["operator"] in PEOPLE and entry["execution"] in DEFAULTS
        if asked and run["task"] == "insertion" and not run["variant"].startswith("lerobot"):
            place = folder / entry["operator"] / run["variant"] / f"seed_{run['seed']}"
            place.mkdir(parents=True, exist_ok=True)
            (place / "eval_info.json").write_text(json.dumps(evaluation(entry)))
            print(place)


if __name__ == "__main__":
    main()
