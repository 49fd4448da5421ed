"""The evaluation on a terminal."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lerobot_act_chunking.diagnostics.core.terminal import print_verdict, table_of
from lerobot_act_chunking.diagnostics.eval.report import EvalReport, RunResult


def print_report(report: EvalReport, console: Console) -> None:
    """Print every policy, why it failed, and the verdict."""
    console.print(_policies(report))
    if report.labels:
        console.print(_failures(report))
    for note in report.notes:
        console.print(f"[dim]- {escape(note)}[/]", highlight=False)
    print_verdict(report, console)


def _policies(report: EvalReport) -> Table:
    outcome = ("successes", "success %", "95 % interval") if report.is_judged else ("successes", "reward")
    table = table_of("policy", *outcome, "seconds", "calls/s", "network ms", "jerk")
    for each in report.results:
        table.add_row(
            escape(each.run.title),
            *(_success(each) if report.is_judged else _what_is_known(each)),
            f"{each.network_calls:.2g}",
            _number(each.milliseconds("network_ms")),
            _number(each.median_of("log_dimensionless_jerk")),
        )
    return table


def _success(result: RunResult) -> list[str]:
    low, high = result.rate.exact_interval
    return [
        f"{result.rate.successes} of {result.rate.episodes}",
        f"{100 * result.rate.rate:.1f}",
        f"{100 * low:.1f}-{100 * high:.1f}",
        _number(result.seconds_to_success),
    ]


def _what_is_known(result: RunResult) -> list[str]:
    """In place of success: the mean sum of rewards, and the median length of all episodes."""
    return [f"? of {result.rate.episodes}", _number(result.sum_reward), _number(result.seconds)]


def _failures(report: EvalReport) -> Table:
    table = table_of("failures", *(escape(each.run.title) for each in report.results))
    for label in report.labels:
        table.add_row(label, *(str(each.failures.get(label, 0)) for each in report.results))
    table.add_row("[dim]of these stalled[/]", *(f"[dim]{each.stalled}[/]" for each in report.results))
    return table


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
