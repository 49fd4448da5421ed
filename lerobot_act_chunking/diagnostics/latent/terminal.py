"""The diagnosis on a terminal."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lerobot_act_chunking.diagnostics.core.terminal import COLOURS, table_of
from lerobot_act_chunking.diagnostics.latent.report import STANDARD, LatentReport
from lerobot_act_chunking.nn.latents.health import ACTIVE_NATS, ACTIVE_VARIANCE

MOST_ROWS = 16
LEGEND = (
    "* what acting uses; error: mean absolute, normalised units; undemonstrated: samples unlike every "
    "demonstrated style; starved: demonstrations whose styles are hardly sampled"
)
SOURCES = {"posterior": "posterior", "shuffled": "another's posterior", "mode": "mode of the prior"}


def print_report(report: LatentReport, console: Console) -> None:
    """Print the divergences, the errors by source of style, the groups and the verdict."""
    origin = f"[dim]({escape(report.subject.checkpoint)})[/]"
    console.print(f"[bold]{describe(report)}[/] {origin}", soft_wrap=True)
    episodes = len(set(report.samples.episode.tolist()))
    data = f"{len(report.samples)} chunks from {episodes} episodes of {report.samples.folder}"
    console.print(data, highlight=False, soft_wrap=True)
    console.print(_divergences(report), highlight=False, soft_wrap=True)
    console.print(_errors_table(report))
    console.print(LEGEND, style="dim", highlight=False)
    console.print(_groups_table(report))
    reasons = "; ".join(report.reasons)
    message = f"[{COLOURS[report.verdict]}]{report.judgement.diagnosis}[/]: {escape(reasons)}"
    console.print(message, highlight=False, soft_wrap=True)


def describe(report: LatentReport) -> str:
    """A latent in one line."""
    config, latent = report.subject.config, report.subject.latent
    what = f"{latent.dim} codes" if report.density is None else f"{latent.dim} dimensions"
    return f"{config.latent_type} latent of {what}, kl_weight {config.kl_weight:g}"


def source_name(report: LatentReport, source: str) -> str:
    """Where a style is from, in words."""
    if source == "mode" and report.subject.config.latent_type == "gaussian":
        return "zero, the mode"
    if source in SOURCES:
        return SOURCES[source]
    return f"sample of {source}" if source == STANDARD else f"sample of the {source}"


def _divergences(report: LatentReport) -> str:
    health = report.health
    by_dimension = sorted(health.kl_by_dimension, reverse=True)
    message = f"KL {health.kl:.3g} nats"
    if len(by_dimension) > 1:
        largest = ", ".join(f"{kl:.2g}" for kl in by_dimension[:MOST_ROWS])
        more = ", ..." if len(by_dimension) > MOST_ROWS else ""
        message += f", {health.kl_active_dims} of {len(by_dimension)} dimensions above {ACTIVE_NATS:g}"
        message += f": {largest}{more}"
    active = f"{health.active_units} active units (variance of the posterior mean above {ACTIVE_VARIANCE:g})"
    return f"{message}\n{active}; {health.by_place:.0%} of their variance is between places in the episode"


def _errors_table(report: LatentReport) -> Table:
    table = table_of("style", "error", "x posterior", "undemonstrated", "starved")
    checks = {check.name: check for check in report.priors}
    best = max(report.errors["posterior"], 1e-12)
    for source, error in report.errors.items():
        check = checks.get(source)
        figures = ("-", "-") if check is None else (f"{check.outside:.1%}", f"{check.starved:.1%}")
        name = source_name(report, source)
        message = f"[bold]{name} *[/]" if source == _acts_with(report) else name
        table.add_row(message, f"{error:.4f}", f"{error / best:.2f}", *figures)
    return table


def _acts_with(report: LatentReport) -> str:
    return report.acting if report.subject.config.z_inference == "sample" else "mode"


def _groups_table(report: LatentReport) -> Table:
    what = "code" if report.density is None else "group"
    table = table_of(what, "demonstrations", *(check.name for check in report.priors), "posterior error")
    order = sorted(range(len(report.groups)), key=lambda group: -report.groups[group].share)
    for i in order[:MOST_ROWS]:
        group = report.groups[i]
        shares = (f"{check.groups[i]:.1%}" for check in report.priors)
        error = "-" if group.error is None else f"{group.error:.4f}"
        table.add_row(str(i + 1), f"{group.share:.1%}", *shares, error)
    return table
