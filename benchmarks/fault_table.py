"""The confusion matrix of docs/instruments/diagnose.md, from the committed results.

    python benchmarks/fault_table.py

reads benchmarks/results/planted_faults.json and writes the table between its marks; a test compares.
"""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results" / "planted_faults.json"
PAGE = ROOT / "docs" / "instruments" / "diagnose.md"
MARK, END = "<!-- faults: python benchmarks/fault_table.py -->", "<!-- end -->"
TYPES = ("act_chunked", "diffusion_chunked", "vqbet_chunked")
WORLDS = {"courier": "", "transfer_cube": " (`transfer_cube`)"}


def rows(cells: list[dict[str, Any]]) -> Iterator[str]:
    """One row for each fault, one column for each policy type."""
    yield "| planted | " + " | ".join(f"`{kind}`" for kind in TYPES) + " |"
    yield "|" + "---|" * (len(TYPES) + 1)
    planted = dict.fromkeys((each["fault"], each["task"]) for each in cells)
    for fault, task in sorted(planted, key=lambda each: (each[1], each[0] != "healthy")):
        said = {
            each["policy"]: shown(each) for each in cells if (each["fault"], each["task"]) == (fault, task)
        }
        yield f"| {fault}{WORLDS[task]} | " + " | ".join(said.get(kind, "-") for kind in TYPES) + " |"


def shown(cell: dict[str, Any]) -> str:
    """What was said of one policy, and in how many episodes it fails."""
    failures = f"{cell['failures']} of {cell['episodes']}"
    if not cell["counts"]:
        return f"too few failures ({failures})"
    said = cell["said"] if cell["right"] else f"**{cell['said']}**"
    return f"{said} ({failures})"


def tally(cells: list[dict[str, Any]]) -> str:
    """How many of the cells that count are right."""
    counted = [each for each in cells if each["counts"]]
    return f"{sum(each['right'] for each in counted)} of {len(counted)}"


def with_table(page: str, cells: list[dict[str, Any]]) -> str:
    """The page with the table between its marks."""
    before, rest = page.split(MARK)
    table = "\n".join([*rows(cells), "", f"Right: {tally(cells)} that count."])
    return f"{before}{MARK}\n\n{table}\n\n{END}{rest.split(END, 1)[1]}"


def main() -> None:
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    PAGE.write_text(with_table(PAGE.read_text(), json.loads(RESULTS.read_text())["cells"]))


if __name__ == "__main__":
    main()
