"""What reports have in common on a terminal."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lerobot_act_chunking.diagnostics.core.report import Report

COLOURS = {"pass": "green", "warn": "yellow", "fail": "red", "inconclusive": "yellow"}


def print_verdict(report: Report, console: Console) -> None:
    """The verdict in its colour, and why."""
    colour, reasons = COLOURS[report.verdict], escape("; ".join(report.reasons))
    console.print(f"[{colour}]{report.verdict}[/]: {reasons}", highlight=False)


def table_of(*names: str) -> Table:
    """An empty table with these columns: the first for names, the others for numbers."""
    table = Table(box=None, pad_edge=False)
    table.add_column(names[0])
    for name in names[1:]:
        table.add_column(name, justify="right")
    return table
