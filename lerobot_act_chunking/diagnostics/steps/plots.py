"""The diagnosis as a picture."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from lerobot_act_chunking.diagnostics.steps.plateau import Series
from lerobot_act_chunking.diagnostics.steps.report import StepsReport
from lerobot_act_chunking.diagnostics.steps.results import CellResult, Quantiles

Value = Callable[[CellResult], float | None]

_COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:purple")
_STYLES = ("-", "--", "-.", ":")
_TOLERANCE = {"color": "black", "linewidth": 1, "linestyle": (0, (6, 2, 1, 2))}


def plot_report(report: StepsReport, path: Path) -> Path:
    """Errors, distributions and time against the number of steps, into a PNG; returns its path."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 8), layout="constrained")
    reference = report.sweep.reference
    figure.suptitle(
        f"{report.settings['type']} ({report.settings['objective']}): few steps against {reference.cell}, "
        f"from the same noise, {report.sweep.n_observations} observations"
    )
    error, near, demonstrations, distribution, spread, time = figure.subplots(2, 3).ravel()
    unit = report.unit
    _draw_error(error, report, lambda result: result.error, f"error, 95 % of the chunks [{unit}]")
    _draw_error(near, report, lambda result: result.error_near_contact, f"the same near contact [{unit}]")
    _draw_demonstrations(demonstrations, report)
    _draw_distribution(distribution, report)
    _draw_spread(spread, report)
    _draw(time, report, lambda result: result.ms, "time per chunk [ms]")
    handles, labels = error.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


def _draw_error(ax: Any, report: StepsReport, errors: Callable[[CellResult], Quantiles], label: str) -> None:
    def p95(result: CellResult) -> float | None:
        found = errors(result)
        return None if found is None else found["p95"]

    ax.axhline(report.tolerance, label="tolerance", **_TOLERANCE)
    floor = report.sweep.reference.disagreement
    if floor is not None and floor["p95"] > 0:
        ax.axhline(
            floor["p95"], color="0.7", linewidth=2, label=f"second reference, {report.sweep.reference.second}"
        )
    _draw(ax, report, p95, label)
    _mark_own(ax, report, p95)


def _draw_demonstrations(ax: Any, report: StepsReport) -> None:
    label = f"mean distance to the demonstrations [{report.unit}]"
    _draw(ax, report, lambda result: result.demonstration_error, label, log=False)
    _mark_own(ax, report, lambda result: result.demonstration_error)
    _mark_reference(ax, report, report.sweep.reference.demonstration_error)


def _draw_distribution(ax: Any, report: StepsReport) -> None:
    """How far whole distributions are apart; where there are modes, what is left of the rarest."""
    rarest = report.sweep.reference.rarest_mode
    if rarest is None:
        label = f"energy distance of the distributions [{report.unit}]"
        _draw(ax, report, lambda result: result.energy, label)
    else:
        _draw(ax, report, lambda result: result.rarest_mode, "mass of the rarest mode", log=False)
        ax.set_ylim(bottom=0)
        _mark_reference(ax, report, rarest)


def _draw_spread(ax: Any, report: StepsReport) -> None:
    """What noise alone does to the position near contact."""
    label = f"spread over noises near contact [{report.unit}]"
    _draw(ax, report, lambda result: result.spread, label, log=False)
    ax.axhline(report.tolerance, **_TOLERANCE)
    ax.set_ylim(bottom=0)
    reference = report.sweep.reference.spread
    if reference is not None:
        _mark_reference(ax, report, reference["p50"])


def _mark_own(ax: Any, report: StepsReport, value: Value) -> None:
    y = value(report.sweep.of(report.own))
    if y:
        style = {"markersize": 11, "markerfacecolor": "none", "color": "tab:red", "linestyle": "none"}
        ax.plot([report.own.n_steps], [y], "o", label="the policy's own", **style)


def _mark_reference(ax: Any, report: StepsReport, y: float) -> None:
    ax.axhline(y, color="0.6", linewidth=0.8)
    low, high = ax.get_ylim()
    if y - low < 0.03 * (high - low):
        return  # no room for a name at the edge
    at = {"textcoords": "offset points", "xycoords": ("axes fraction", "data"), "ha": "right"}
    ax.annotate(str(report.sweep.reference.cell), (1, y), (-4, 3), fontsize=8, color="0.4", **at)


def _draw(ax: Any, report: StepsReport, value: Value, label: str, *, log: bool = True) -> None:
    """One line per sampler and spacing."""
    samplers = list(dict.fromkeys(series.sampler for series in report.judgement.series))
    for i, series in enumerate(report.judgement.series):
        points = [(each.cell.n_steps, value(each)) for each in _cells(report, series)]
        shown = [(n, y) for n, y in points if y is not None and (y > 0 or not log)]
        colour = _COLOURS[samplers.index(series.sampler)]
        if shown:
            style = {"linestyle": _STYLES[i % len(_STYLES)], "marker": ".", "color": colour}
            ax.plot(*zip(*shown, strict=True), label=series.name, **style)
    ax.set(xscale="log", yscale="log" if log else "linear", xlabel="denoising steps", ylabel=label)
    ax.grid(alpha=0.3)
    _label_logarithmic(ax.xaxis)
    if log:
        _label_logarithmic(ax.yaxis)


def _cells(report: StepsReport, series: Series) -> list[CellResult]:
    key = series.sampler, series.spacing
    return [each for each in report.sweep.cells if (each.cell.sampler, each.cell.spacing) == key]


def _label_logarithmic(axis: Any) -> None:
    """Plain numbers at 1, 2 and 5 times powers of ten, or at powers alone over many decades."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < 300 * low else (1,), numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
