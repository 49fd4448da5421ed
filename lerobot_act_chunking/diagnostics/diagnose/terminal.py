"""The diagnosis on a terminal."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lerobot_act_chunking.diagnostics.core.terminal import print_verdict, table_of
from lerobot_act_chunking.diagnostics.diagnose.effects import LEVEL
from lerobot_act_chunking.diagnostics.diagnose.report import DiagnoseReport

MARKS = {True: "[red]yes[/]", False: "no", None: "[dim]?[/]"}


def print_report(report: DiagnoseReport, console: Console) -> None:
    """Print what was seen, what every intervention did, the verdict, and what to change."""
    source = f"[dim]({report.policy_type}, {escape(report.requested.checkpoint)})[/]"
    console.print(f"[bold]Failures on {escape(report.where)}[/] {source}", soft_wrap=True)
    failures = report.failures
    if failures is not None:
        labels = ", ".join(f"{label} {count}" for label, count in report.content()["labels"].items())
        told = f"{failures.successes} of {failures.episodes} episodes fail{f': {labels}' if labels else ''}"
        console.print(escape(told), highlight=False)
    console.print(_seen(report))
    if report.effects:
        console.print(_interventions(report))
    for note in report.notes:
        console.print(f"[dim]- {escape(note)}[/]", highlight=False)
    print_verdict(report, console)
    for cause in report.causes:
        if cause.repair:
            line = f"{cause.name}: {cause.repair}"
            console.print(line, highlight=False, soft_wrap=True, markup=False)
    if report.folder is not None:
        console.print(f"episodes: {report.folder}", highlight=False, soft_wrap=True, markup=False)


def _seen(report: DiagnoseReport) -> Table:
    table = Table(box=None, pad_edge=False)
    for name in ("seen", "", "evidence"):
        table.add_column(name)
    for finding in report.seen.findings:
        table.add_row(finding.name, MARKS[finding.found], escape(finding.evidence))
    return table


def _interventions(report: DiagnoseReport) -> Table:
    table = table_of("intervention", "repairs", "95 % interval", "breaks", "net %", "p")
    for effect, p in report.effects:
        recovered, broken = effect.recovered, effect.broken
        low, high = (100 * end for end in recovered.exact_interval)
        sure = "green" if p < LEVEL and effect.net > 0 else "dim"
        table.add_row(
            f"[{sure}]{escape(effect.trial.hypothesis)}[/]: {escape(effect.trial.change)}",
            f"{recovered.successes} of {recovered.episodes}",
            f"{low:.0f}-{high:.0f} %",
            "-" if broken is None else f"{broken.successes} of {broken.episodes}",
            f"{100 * effect.net:.0f}",
            f"{p:.2g}",
        )
    return table
