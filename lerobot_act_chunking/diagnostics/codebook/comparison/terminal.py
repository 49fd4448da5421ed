"""The comparison of tokenizers on a terminal."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lerobot_act_chunking.diagnostics.codebook.comparison.report import ComparisonReport, Fitted
from lerobot_act_chunking.diagnostics.codebook.losses import Loss
from lerobot_act_chunking.diagnostics.core.terminal import print_verdict

IN_SPACE = "; in space: mean of the point that is farthest off"


def print_report(report: ComparisonReport, console: Console) -> None:
    """Print what each tokenizer costs and loses, and which one to take."""
    timing, demonstrations = report.timing, report.demonstrations
    seconds = timing.control_steps / demonstrations.fps
    title = f"Tokenizers for {timing.chunk_size} actions, {seconds:.2g} s"
    console.print(f"[bold]{title}[/] [dim]({escape(demonstrations.folder)})[/]", soft_wrap=True)
    n_held_out = len(report.held_out)
    fitted_to = f"{len(demonstrations.episodes) - n_held_out} episodes"
    message = f"fitted to {fitted_to} ({report.steps} steps, if at all), errors on {n_held_out} others:"
    console.print(message, highlight=False, soft_wrap=True)
    console.print(_table(report))
    console.print(f"[dim]- {_note(report)}[/]", highlight=False)
    console.print(f"recommended: {report.flags}", highlight=False, soft_wrap=True, markup=False)
    print_verdict(report, console)


def _note(report: ComparisonReport) -> str:
    """What the columns mean, and how many dimensions stand still and are no part of them."""
    losses = report.fitted[0].losses
    n_dims = len(losses.dimensions)
    moving = sum(loss.lost_variance is not None for loss in losses.dimensions)
    over = "the dimensions" if moving == n_dims else f"the {moving} of {n_dims} dimensions that move"
    space = IN_SPACE if losses.points else ""
    return f"lost: share of the variance, mean over {over}, then that of the worst{space}."


def _table(report: ComparisonReport) -> Table:
    table = Table(box=None, pad_edge=False, collapse_padding=True)
    losses = report.fitted[0].losses
    points = [f"\\[{losses.unit}]"] if losses.points else []
    table.add_column("tokenizer", no_wrap=True)
    for name in ("tokens", "bits", "lost", "most lost", *points, "CPU s"):
        table.add_column(name, justify="right", no_wrap=True)
    for fitted in report.fitted:
        table.add_row(*_row(fitted, fitted is report.recommended))
    return table


def _row(fitted: Fitted, is_recommended: bool) -> list[str]:
    name = fitted.candidate.name
    worst = worst_dimension(fitted)
    points = fitted.losses.points
    return [
        f"[green]{name}[/]" if is_recommended else name,
        str(fitted.tokens),
        f"{fitted.bits:.0f}",
        f"{fitted.losses.lost_variance:.1%}",
        f"{worst.name} {min(1.0, worst.lost_variance or 0.0):.0%}",
        *([f"{max(point.mean for point in points):.2g}"] if points else []),
        f"{fitted.seconds:.1f}",
    ]


def worst_dimension(fitted: Fitted) -> Loss:
    """The dimension of whose variance most is lost."""
    return max(fitted.losses.dimensions, key=lambda loss: loss.lost_variance or 0.0)
