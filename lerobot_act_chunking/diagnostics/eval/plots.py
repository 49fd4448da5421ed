"""The evaluation as a picture."""

from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

from lerobot_act_chunking.diagnostics.eval.report import EvalReport, RunResult


def plot_report(report: EvalReport, path: Path) -> Path:
    """Success rates with their intervals, and failures by their labels, into a PNG; returns its path.

    Where nothing is known of success: rewards, lengths and smoothness of the episodes.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 1.8 + 0.4 * len(report.results)), layout="constrained")
    reason = report.reasons[0 if report.is_judged else -1]  # that success is unknown comes last
    figure.suptitle(f"{report.verdict}: {reason}", fontsize=10, wrap=True)
    if report.is_judged:
        rates, failures = figure.subplots(1, 2, sharey=True)
        _draw_rates(rates, report)
        _draw_failures(failures, report)
    else:
        _draw_what_is_known(figure.subplots(1, 3, sharey=True), report)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


def _draw_rates(ax: Any, report: EvalReport) -> None:
    for place, result in enumerate(report.results):
        low, high = result.rate.exact_interval
        ax.plot([100 * low, 100 * high], [place, place], color="tab:blue", linewidth=2)
        ax.plot(100 * result.rate.rate, place, "o", color="tab:blue")
    ax.set(xlabel="success [%], 95 % Clopper-Pearson", xlim=(0, 100))
    _name_rows(ax, report)


def _name_rows(ax: Any, report: EvalReport) -> None:
    ax.set_yticks(range(len(report.results)), [each.run.title for each in report.results])
    ax.set_ylim(len(report.results) - 0.5, -0.5)
    ax.grid(axis="x", alpha=0.3)


def _draw_failures(ax: Any, report: EvalReport) -> None:
    """Stacked bars: the share of all episodes that failed in each way."""
    left = [0.0] * len(report.results)
    for label in report.labels:
        shares = [100 * each.failures.get(label, 0) / each.rate.episodes for each in report.results]
        ax.barh(range(len(shares)), shares, left=left, height=0.5, label=label)
        left = [start + share for start, share in zip(left, shares, strict=True)]
    ax.set(xlabel="failures [% of episodes]")
    if report.labels:
        ax.legend(loc="center left", bbox_to_anchor=(1, 0.5), fontsize=8, frameon=False)
    else:
        ax.text(0.5, 0.5, "no failure", ha="center", va="center", transform=ax.transAxes, color="0.5")


def _draw_what_is_known(axes: Sequence[Any], report: EvalReport) -> None:
    """Every episode as a point, and the median of each policy as a line."""
    for place, result in enumerate(report.results):
        for ax, (label, values) in zip(axes, _known(result).items(), strict=True):
            ax.plot(values, [place] * len(values), "o", color="tab:blue", alpha=0.3, markeredgewidth=0)
            if values:
                ax.vlines(median(values), place - 0.3, place + 0.3, color="tab:blue", linewidth=2)
            ax.set(xlabel=label)
    for ax in axes:
        _name_rows(ax, report)


def _known(result: RunResult) -> dict[str, list[float]]:
    jerk = (each.log_dimensionless_jerk for each in result.episodes)
    return {
        "sum of rewards": [each.sum_reward for each in result.episodes],
        "length [s]": [result.dt * each.length for each in result.episodes],
        "log jerk (nearer to 0 is smoother)": [each for each in jerk if each is not None],
    }
