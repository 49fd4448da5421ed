"""The comparison as a picture."""

from pathlib import Path
from typing import Any

from lerobot_act_chunking.diagnostics.compare.report import CompareReport
from lerobot_act_chunking.diagnostics.compare.verdict import LEVEL


def plot_report(report: CompareReport, path: Path) -> Path:
    """Success rates and differences, each with its interval, into a PNG; returns its path."""
    from matplotlib.figure import Figure

    rows = max(sum(len(each.rates) for each in report.trials), len(report.contrasts))
    figure = Figure(figsize=(12, 1.8 + 0.35 * rows), layout="constrained")
    figure.suptitle(f"{report.verdict}: {report.reasons[0]}", fontsize=10, wrap=True)
    rates, differences = figure.subplots(1, 2)
    _draw_rates(rates, report)
    _draw_differences(differences, report)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


def _draw_rates(ax: Any, report: CompareReport) -> None:
    labels: list[str] = []
    for trials, letters in zip(report.trials, report.letters, strict=True):
        for place, rate in enumerate(trials.rates):
            low, high = rate.exact_interval
            ax.plot([100 * low, 100 * high], [len(labels)] * 2, color="tab:blue", linewidth=2)
            ax.plot(100 * rate.rate, len(labels), "o", color="tab:blue")
            labels.append(f"{trials.name} ({letters})" if place == 0 else "")
    ax.set(xlabel="success [%], 95 % Clopper-Pearson", xlim=(0, 100), title="Each policy, each training")
    _list(ax, labels)


def _draw_differences(ax: Any, report: CompareReport) -> None:
    labels = []
    for found, adjusted in zip(report.contrasts, report.adjusted, strict=True):
        colour = "tab:green" if adjusted < LEVEL else "tab:orange"
        ax.plot([100 * end for end in found.interval], [len(labels)] * 2, color=colour, linewidth=2)
        ax.plot(100 * found.difference, len(labels), "o", color=colour)
        labels.append(f"{found.first} - {found.second}")
    ax.axvline(0, color="gray", linewidth=1)
    ax.set(xlabel="difference [points], 95 %; green: decided (Holm)", title="Every two")
    _list(ax, labels)


def _list(ax: Any, labels: list[str]) -> None:
    ax.set_yticks(range(len(labels)), labels)
    ax.set_ylim(len(labels) - 0.5, -0.5)
    ax.grid(axis="x", alpha=0.3)
