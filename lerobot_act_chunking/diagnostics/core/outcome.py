"""How every diagnosis ends: a verdict with its exit status and colour, and its numbers in a file."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

# Apart from 1 (refused) and 2 (wrong usage), so that a script can tell a bad policy from a missing file.
EXIT_CODES = {"pass": 0, "warn": 0, "inconclusive": 10, "fail": 11}
COLOURS = {"pass": "green", "warn": "yellow", "fail": "red", "inconclusive": "yellow"}


def print_verdict(verdict: str, reasons: Sequence[str], console: Console) -> None:
    """The verdict in its colour, and why."""
    console.print(f"[{COLOURS[verdict]}]{verdict}[/]: {escape('; '.join(reasons))}", highlight=False)


def with_untrained(verdict: str, reasons: Sequence[str], untrained: str | None) -> tuple[str, list[str]]:
    """The verdict and its reasons; where the policy is untrained that comes first, and it passes nothing."""
    if untrained is None:
        return verdict, [*reasons]
    return "warn" if verdict == "pass" else verdict, [untrained, *reasons]


def write_json(content: dict[str, Any], path: Path) -> Path:
    """Write plain numbers, strings, lists and dictionaries to a file, creating its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
    return path
