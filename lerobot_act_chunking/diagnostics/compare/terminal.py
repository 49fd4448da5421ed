"""The comparison on a terminal."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lerobot_act_chunking.diagnostics.compare.report import CompareReport
from lerobot_act_chunking.diagnostics.compare.verdict import LEVEL
from lerobot_act_chunking.diagnostics.core.terminal import print_verdict, table_of


def print_report(report: CompareReport, console: Console) -> None:
    """Print every policy, every two of them, and the verdict."""
    console.print(_policies(report))
    console.print(_contrasts(report))
    for note in report.notes:
        console.print(f"[dim]- {escape(note)}[/]", highlight=False)
    print_verdict(report, console)


def _policies(report: CompareReport) -> Table:
    several = len(report.trials[0].rates) > 1
    table = table_of("policy", "", "successes", "success %", "95 % interval", *(("seeds apart",) * several))
    for trials, letters in zip(report.trials, report.letters, strict=True):
        for place, rate in enumerate(trials.rates):
            low, high = rate.exact_interval
            cells = [
                f"{rate.successes} of {rate.episodes}",
                f"{100 * rate.rate:.1f}",
                f"{100 * low:.1f}-{100 * high:.1f}",
            ]
            name = escape(trials.name) if place == 0 else ""
            table.add_row(name, letters if place == 0 else "", *cells)
        if several and trials.seeds_apart is not None:
            apart = f"{100 * trials.seeds_apart:.1f} (chance: {100 * trials.episodes_apart:.1f})"
            table.add_row("", "", "mean", f"{100 * trials.mean:.1f}", "", apart)
    return table


def _contrasts(report: CompareReport) -> Table:
    paired = report.contrasts[0].pairs is not None
    own = ("only 1st", "only 2nd", "e-value") if paired else ()
    table = table_of("difference", "points", "95 % interval", "p (Holm)", "shows", *own)
    for found, adjusted in zip(report.contrasts, report.adjusted, strict=True):
        low, high = (100 * end for end in found.interval)
        colour = "green" if adjusted < LEVEL else "yellow"
        cells = [
            f"{100 * found.difference:+.1f}",
            f"{low:.1f} to {high:.1f}",
            f"[{colour}]{adjusted:.2g}[/]",
            f"{100 * found.smallest:.0f}" if found.smallest <= 1 else "-",
        ]
        if found.pairs is not None:
            pairs = found.pairs
            cells += [str(pairs.only_first), str(pairs.only_second), f"{pairs.e_value:.2g}"]
        table.add_row(escape(f"{found.first} - {found.second}"), *cells)
    return table
