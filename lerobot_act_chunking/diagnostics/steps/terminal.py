"""The diagnosis on a terminal."""

from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lerobot_act_chunking.diagnostics.core.measures import RawUnits
from lerobot_act_chunking.diagnostics.core.terminal import print_verdict
from lerobot_act_chunking.diagnostics.steps.plateau import Series
from lerobot_act_chunking.diagnostics.steps.report import StepsReport
from lerobot_act_chunking.diagnostics.steps.results import CellResult, Quantiles

MOST_NAMED = 3


def print_report(report: StepsReport, console: Console) -> None:
    """Print the sweep, what the model itself is worth, what to know about it, and the verdict."""
    source = f"[dim]({report.settings['objective']}, {report.requested.checkpoint})[/]"
    console.print(f"[bold]{report.own} of {report.settings['type']}[/] {source}", soft_wrap=True)
    console.print(f"Error of 95 % of the chunks against {report.sweep.reference.cell}, in {report.unit}:")
    console.print(_sweep_table(report))
    facts = Table(show_header=False, box=None, pad_edge=False)
    for row in _rows(report):
        facts.add_row(*row)
    console.print(facts)
    for note in report.notes:
        console.print(f"[dim]- {note}[/]", highlight=False)
    print_verdict(report, console)


def _sweep_table(report: StepsReport) -> Table:
    """Errors by steps (down) and sampler (across); green where they are within the tolerance."""
    table = Table(box=None, pad_edge=False)
    table.add_column("steps", justify="right")
    for series in report.judgement.series:
        table.add_column(series.name, justify="right")
    results = {(each.cell.sampler, each.cell.spacing, each.cell.n_steps): each for each in report.sweep.cells}
    for n in sorted({each.cell.n_steps for each in report.sweep.cells}):
        row = [results.get((series.sampler, series.spacing, n)) for series in report.judgement.series]
        table.add_row(str(n), *(_entry(each, report) for each in row))
    return table


def _entry(result: CellResult | None, report: StepsReport) -> str:
    if result is None:
        return "-"
    if result.error is None:
        return "flipped"
    text = f"{result.error['p95']:.3g}"
    enough = result.error["p95"] < report.tolerance
    mark = "*" if result.cell == report.own else ""
    return f"{mark}[green]{text}[/]" if enough else f"{mark}{text}"


def _rows(report: StepsReport) -> list[tuple[str, str]]:
    reference, unit = report.sweep.reference, report.unit
    series = report.judgement.series
    rows = [
        ("order of convergence", _by_series(series, [each.order for each in series], ".1f")),
        ("plateau \\[steps]", _by_series(series, [each.plateau for each in series], "d")),
        ("observations", _observations(report)),
        (f"{reference.second} against it", _quantiles(reference.disagreement, unit)),
        ("spread near contact", f"{_quantiles(reference.spread, unit)}, over noises at {reference.cell}"),
        ("to demonstrations", _to_demonstrations(report)),
        ("modes", _modes(report)),
        (f"{report.own} (*)", _own(report)),
    ]
    if isinstance(report.held_out.measure, RawUnits):
        rows.append(("farthest off", _farthest(report)))
    rows += [(f"success, {each.cell}", str(each.rate)) for each in report.success or []]
    return [*rows, ("recommended", _recommended(report))]


def _by_series(series: Sequence[Series], values: Sequence[float | None], form: str) -> str:
    texts = ("-" if value is None else format(value, form) for value in values)
    return ", ".join(f"{each.name} {value}" for each, value in zip(series, texts, strict=True))


def _observations(report: StepsReport) -> str:
    episodes = report.held_out.episodes
    return (
        f"{report.sweep.n_observations} from episodes {episodes[0]} to {episodes[-1]}, "
        f"{report.sweep.n_near_contact} near contact; {report.settings['executed_steps']} control steps each"
    )


def _quantiles(values: Quantiles, unit: str) -> str:
    if values is None:
        return "not measured"
    return f"median {values['p50']:.2g} {unit}, 95 % {values['p95']:.2g} {unit}"


def _to_demonstrations(report: StepsReport) -> str:
    reference = report.sweep.reference
    near = _quantiles(reference.demonstration_error_near_contact, report.unit)
    return f"mean {reference.demonstration_error:.3g} {report.unit}; near contact {near}"


def _modes(report: StepsReport) -> str:
    reference = report.sweep.reference
    if reference.separation is None:
        return "one for each observation"
    counts = [f"{n} with {i}" for i, n in enumerate(reference.mode_counts, start=1) if n]
    return f"observations: {', '.join(counts)}; {reference.separation:.2g} {report.unit} apart"


def _own(report: StepsReport) -> str:
    own = report.sweep.of(report.own)
    parts = [_quantiles(own.error, report.unit)]
    if own.error_near_contact is not None:
        parts.append(f"near contact {own.error_near_contact['p95']:.2g} {report.unit}")
    if own.flip_rate:
        parts.append(f"{own.flip_rate:.0%} flipped")
    if own.ms is not None:
        parts.append(f"{own.ms:.3g} ms")
    return ", ".join(parts)


def _farthest(report: StepsReport) -> str:
    """The dimensions that decide: one tolerance counts for all, whatever each is measured in."""
    errors = report.sweep.of(report.own).error_by_point or {}
    worst = sorted(errors, key=lambda name: -errors[name])[:MOST_NAMED]
    return ", ".join(f"{escape(name)} {errors[name]:.2g}" for name in worst) or "not measured"


def _recommended(report: StepsReport) -> str:
    recommended = report.judgement.recommended
    if report.verdict == "inconclusive":
        return "nothing while the verdict is open"
    if recommended is None:
        return "no sampler gets there: train longer, or allow more"
    result = report.sweep.of(recommended.cell)
    time = "" if result.ms is None else f", {result.ms:.3g} ms"
    return f"{recommended.flags}\n{recommended.reason}: {recommended.evaluations} network calls{time} a chunk"
