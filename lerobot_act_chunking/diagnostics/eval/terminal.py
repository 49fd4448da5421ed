"""The evaluation on a terminal."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lerobot_act_chunking.diagnostics.core.terminal import print_verdict, table_of
from lerobot_act_chunking.diagnostics.eval.report import EvalReport


def print_report(report: EvalReport, console: Console) -> None:
    """Print every policy, why it failed, and the verdict."""
    console.print(_policies(report))
    if any(each.failures and each.is_judged for each in report.results):
        console.print(_failures(report))
    for note in report.notes:
        console.print(f"[dim]- {escape(note)}[/]", highlight=False)
    print_verdict(report, console)


def _policies(report: EvalReport) -> Table:
    table = table_of(
        "policy", "successes", "success %", "95 % interval", "seconds", "calls/s", "network ms", "jerk"
    )
    for each in report.results:
        low, high = each.rate.exact_interval
        table.add_row(
            escape(each.run.title),
            f"{each.rate.successes if each.is_judged else '?'} of {each.rate.episodes}",
            f"{100 * each.rate.rate:.1f}" if each.is_judged else "?",
            f"{100 * low:.1f}-{100 * high:.1f}" if each.is_judged else "?",
            _number(each.seconds_to_success),
            f"{each.network_calls:.2g}",
            _number(each.milliseconds("network_ms")),
            _number(each.median_of("log_dimensionless_jerk")),
        )
    return table


def _failures(report: EvalReport) -> Table:
    table = table_of("failures", *(escape(each.run.title) for each in report.results))
    for label in report.labels:
        table.add_row(label, *(str(each.failures.get(label, 0)) for each in report.results))
    table.add_row("[dim]of these stalled[/]", *(f"[dim]{each.stalled}[/]" for each in report.results))
    return table


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
