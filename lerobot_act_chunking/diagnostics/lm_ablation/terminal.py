"""The comparison on a terminal."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lerobot_act_chunking.diagnostics.core.terminal import print_verdict, table_of
from lerobot_act_chunking.diagnostics.lm_ablation.report import LmAblationReport


def print_report(report: LmAblationReport, console: Console) -> None:
    """Print every cell, every effect over all sizes, the match, and the verdict."""
    console.print(_cells(report))
    console.print(_effects(report))
    match = report.match
    console.print(
        f"transformer and mixer: weights {match.parameters['bert']} and {match.parameters['mixer']} "
        f"({100 * match.parameters_apart:.1f} % apart), operations {match.flops['bert']} and "
        f"{match.flops['mixer']} ({100 * match.flops_apart:.1f} % apart)",
        highlight=False,
    )
    for note in report.notes:
        console.print(f"[dim]- {escape(note)}[/]", highlight=False)
    print_verdict(report, console)


def _cells(report: LmAblationReport) -> Table:
    conditions = [f"{name} %" for name in report.settings.conditions]
    table = table_of("cell", "demonstrations", "trainings", *conditions, "loss", "learned after", "CPU s")
    for row in report.rows:
        after = "never" if row.learned_after is None else f"{row.learned_after:g}"
        rates = [f"{100 * rate:.1f}" for rate in row.success.values()]
        table.add_row(
            row.cell,
            str(row.size),
            str(row.trainings),
            *rates,
            f"{row.validation_loss:.3f}",
            after,
            f"{row.seconds:.0f}",
        )
    return table


def _effects(report: LmAblationReport) -> Table:
    table = table_of("effect", "condition", "demonstrations", "points", "95 % interval", "seeds")
    only = {each.size for each in report.effects} - {None}
    for found in report.effects:
        if found.size is not None and len(only) > 1:
            continue
        low, high = (100 * end for end in found.interval)
        colour = "green" if found.decided else "yellow"
        table.add_row(
            found.name,
            found.condition,
            "all" if found.size is None else str(found.size),
            f"[{colour}]{100 * found.value:+.1f}[/]",
            f"{low:.1f} to {high:.1f}",
            str(found.seeds),
        )
    return table
