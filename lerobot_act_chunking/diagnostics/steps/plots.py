"""The diagnosis as a picture."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from lerobot_act_chunking.diagnostics.steps.plateau import Series
from lerobot_act_chunking.diagnostics.steps.report import StepsReport
from lerobot_act_chunking.diagnostics.steps.results import CellResult

_COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:purple")
_DASHES = {None: "-", "leading": "-", "trailing": "--", "linspace": ":"}


def plot_report(report: StepsReport, path: Path) -> Path:
    """Error, time, distribution and spread against the number of steps, into a PNG; returns its path."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 8), layout="constrained")
    settings = report.settings
    figure.suptitle(
        f"Denoising steps: {settings['type']}, {settings['objective']}, held against "
        f"{report.sweep.reference.cell} on {report.sweep.n_observations} observations"
    )
    error, time, distribution, spread = figure.subplots(2, 2).ravel()
    _draw_error(error, report)
    _draw(time, report, lambda result: result.ms, "time per chunk [ms]")
    _draw_distribution(distribution, report)
    _draw_spread(spread, report)
    error.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


def _draw_error(ax: Any, report: StepsReport) -> None:
    _draw(
        ax,
        report,
        lambda result: None if result.error is None else result.error["p95"],
        f"error of 95 % of the chunks [{report.unit}]",
    )
    ax.axhline(report.tolerance, color="black", linewidth=1, linestyle="-.", label="tolerance")
    floor = report.sweep.reference.disagreement
    if floor is not None and floor["p95"] > 0:
        ax.axhline(floor["p95"], color="0.7", linewidth=1, label=f"{report.sweep.reference.second}")
    own = report.sweep.of(report.own).error
    if own is not None and own["p95"] > 0:
        ax.plot(report.own.n_steps, own["p95"], "o", markersize=11, markerfacecolor="none", color="tab:red",
                label="the policy's own")  # fmt: skip


def _draw_distribution(ax: Any, report: StepsReport) -> None:
    """How far whole distributions are apart and, where there are modes, what is left of the rarest."""
    _draw(
        ax,
        report,
        lambda result: result.energy_share and 100 * result.energy_share,
        "energy distance to the reference\n[% of the largest possible]",
    )
    if report.sweep.reference.rarest_mode is None:
        return
    twin = ax.twinx()
    _draw(
        twin, report, lambda result: result.rarest_mode, "mass of the rarest mode (dots)", mark="o", log=False
    )
    twin.axhline(report.sweep.reference.rarest_mode, color="0.6", linewidth=0.8)
    twin.set_ylim(bottom=0)


def _draw_spread(ax: Any, report: StepsReport) -> None:
    """What noise alone does to the position near contact."""
    _draw(
        ax,
        report,
        lambda result: result.spread,
        f"spread over noises near contact [{report.unit}]",
        log=False,
    )
    reference = report.sweep.reference.spread
    if reference is not None:
        ax.axhline(reference["p50"], color="0.6", linewidth=0.8)
        ax.annotate(
            f"{report.sweep.reference.cell}", (1, reference["p50"]), (0, 3), textcoords="offset points",
            xycoords=("axes fraction", "data"), ha="right", fontsize=8, color="0.4",
        )  # fmt: skip
    ax.axhline(report.tolerance, color="black", linewidth=1, linestyle="-.")
    ax.set_ylim(bottom=0)


def _draw(
    ax: Any,
    report: StepsReport,
    value: Callable[[CellResult], float | None],
    label: str,
    *,
    mark: str = ".-",
    log: bool = True,
) -> None:
    """One line per sampler and spacing."""
    samplers = list(dict.fromkeys(series.sampler for series in report.judgement.series))
    for series in report.judgement.series:
        points = [(each.cell.n_steps, value(each)) for each in _cells(report, series)]
        shown = [(n, y) for n, y in points if y is not None and (y > 0 or not log)]
        style = {"linestyle": _DASHES[series.spacing]} if "-" in mark else {"linestyle": "none"}
        name = f"{series.sampler} {series.spacing}" if series.spacing else series.sampler
        colour = _COLOURS[samplers.index(series.sampler)]
        if shown:
            ax.plot(*zip(*shown, strict=True), marker=mark[0], color=colour, label=name, **style)
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
    subs = (1, 2, 5) if high < 300 * low else (1,)
    axis.set_major_locator(LogLocator(subs=subs, numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
