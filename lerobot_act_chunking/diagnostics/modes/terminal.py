"""The diagnosis on a terminal."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lerobot_act_chunking.diagnostics.core.terminal import print_verdict, table_of
from lerobot_act_chunking.diagnostics.modes.inside import CodeModes, LatentModes
from lerobot_act_chunking.diagnostics.modes.report import ModesReport

INVALID = "none"


def print_report(report: ModesReport, console: Console) -> None:
    """Print the ways, what is inside of the policy, and the verdict."""
    if report.episodes is not None:
        console.print(_ways(report))
        console.print(_measures(report), highlight=False)
    if isinstance(report.inside, LatentModes):
        console.print(
            f"latent: {report.inside.kl:.2g} nats, {report.inside.active_units} active units", highlight=False
        )
    if isinstance(report.inside, CodeModes):
        console.print(
            f"codes: {report.inside.shared} combinations are shared by several ways", highlight=False
        )
    for note in report.notes:
        console.print(f"[dim]- {escape(note)}[/]", highlight=False)
    print_verdict(report, console)


def _ways(report: ModesReport) -> Table:
    """A row for each way, and one for what goes none of them; in per cent."""
    episodes, inside = report.episodes, report.inside
    assert episodes is not None  # noqa: S101
    kinds = {} if report.chunks is None else {"chunks": report.chunks.frequencies}
    if isinstance(inside, LatentModes):
        kinds |= {"prior": inside.prior, "posterior": inside.posterior, "likeliest": inside.likeliest}
    extra: dict[str, list[float | None]] = {
        name: [*each.shares, each.invalid_share] for name, each in kinds.items()
    }
    if inside is not None:
        extra["own"] = [*inside.reconstructed, None]
    table = table_of("mode", "shown %", "episodes", "95 %", "success", *extra)
    shown, taken = [*episodes.proportions, None], [*episodes.shares, episodes.invalid_share]
    for row, success in enumerate(report.successes):
        last = row == len(episodes.counts)
        low, high = (None, None) if last else episodes.intervals[row]
        table.add_row(
            INVALID if last else str(row),
            _percent(shown[row]),
            _percent(taken[row]),
            "" if low is None or high is None else f"{100 * low:.1f}-{100 * high:.1f}",
            _percent(success and success.rate),
            *(_percent(values[row]) for values in extra.values()),
        )
    return table


def _measures(report: ModesReport) -> str:
    episodes = report.episodes
    assert episodes is not None  # noqa: S101
    divergence, p_value = episodes.divergence, episodes.p_value
    parts = [
        f"balanced coverage {episodes.balanced_coverage:.2f}",
        *([] if divergence is None else [f"KL from the demonstrations {divergence:.2g} nats"]),
        *([] if p_value is None else [f"same proportions: p = {p_value:.2g}"]),
    ]
    if report.switching is not None:
        parts.append(f"{report.switching.share:.0%} of the episodes change their way")
    return "; ".join(parts)


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.1f}"
