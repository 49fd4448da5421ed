"""The evaluation as a picture."""

from pathlib import Path
from typing import Any

from lerobot_act_chunking.diagnostics.eval.report import EvalReport


def plot_report(report: EvalReport, path: Path) -> Path:
    """Success rates with their intervals, and failures by their labels, into a PNG; returns its path."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 1.8 + 0.4 * len(report.results)), layout="constrained")
    figure.suptitle(f"{report.verdict}: {report.reasons[0]}", fontsize=10, wrap=True)
    rates, failures = figure.subplots(1, 2, sharey=True)
    _draw_rates(rates, report)
    _draw_failures(failures, report)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


def _draw_rates(ax: Any, report: EvalReport) -> None:
    for place, result in enumerate(report.results):
        low, high = result.rate.exact_interval
        ax.plot([100 * low, 100 * high], [place, place], color="tab:blue", linewidth=2)
        ax.plot(100 * result.rate.rate, place, "o", color="tab:blue")
    ax.set(xlabel="success [%], 95 % Clopper-Pearson", xlim=(0, 100))
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
