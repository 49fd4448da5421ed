"""The diagnosis as a picture."""

from pathlib import Path
from typing import Any

import numpy as np

from lerobot_act_chunking.data.dimension_names import is_hand
from lerobot_act_chunking.diagnostics.replay.report import ReplayReport

SHOWN = 3  # dimensions
LINES = {
    "policy": ("tab:blue", "policy"),
    "hold_still": ("gray", "hold still"),
    "nearest": ("tab:orange", "nearest demonstration"),
}


def plot_report(report: ReplayReport, path: Path) -> Path:
    """Chunks over the demonstration, and the error over the horizon, into a PNG; returns its path."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 7), layout="constrained")
    figure.suptitle(f"{report.policy_type}: {report.verdict}; {report.which}")
    dims = _shown(report)
    grid = figure.add_gridspec(len(dims), 2, width_ratios=(1.5, 1))
    for row, dim in enumerate(dims):
        _draw_chunks(figure.add_subplot(grid[row, 0]), report, dim, last=row == len(dims) - 1)
    _draw_errors(figure.add_subplot(grid[:, 1]), report)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


def _shown(report: ReplayReport) -> list[int]:
    """The dimensions that move most in the drawn episode for their spread, a gripper among them."""
    moving = report.floor.moving or list(range(len(report.names)))
    travelled = np.ptp(report.drawn.done, axis=0) / np.maximum(report.spread, 1e-9)
    order = sorted(moving, key=lambda dim: -travelled[dim])
    hands = [dim for dim in order if is_hand(report.names[dim])][:1]
    arms = [dim for dim in order if not is_hand(report.names[dim])]
    return [*arms[: SHOWN - len(hands)], *hands]


def _draw_chunks(ax: Any, report: ReplayReport, dim: int, last: bool) -> None:
    drawn = report.drawn
    ax.plot(np.arange(len(drawn.done)) / report.fps, drawn.done[:, dim], color="black", label="demonstrated")
    for number, (at, chunk) in enumerate(zip(drawn.at, drawn.chunks, strict=True)):
        time = (at + np.arange(len(chunk))) / report.fps
        label = "predicted chunks" if number == 0 else None
        ax.plot(time, chunk[:, dim], color="tab:blue", alpha=0.6, linewidth=1.2, label=label)
        ax.plot(time[0], chunk[0, dim], ".", color="tab:blue")
    ax.set(ylabel=report.names[dim], xlim=(0, len(drawn.done) / report.fps))
    ax.grid(alpha=0.3)
    if last:
        ax.set_xlabel(f"time in episode {drawn.episode} [s]")
        ax.legend(loc="best", fontsize=8)


def _draw_errors(ax: Any, report: ReplayReport) -> None:
    """Mean over the moving dimensions, each in its standard deviations."""
    moving = report.floor.moving or list(range(len(report.names)))
    spread = np.maximum(report.spread[moving], 1e-9)
    for name in report.horizon.median:
        colour, label = LINES[name]
        median, p90 = (
            (found[name][:, moving] / spread).mean(1) for found in (report.horizon.median, report.horizon.p90)
        )
        time = np.arange(len(median)) / report.fps
        ax.plot(time, median, color=colour, label=f"{label}, median")
        ax.plot(time, p90, "--", color=colour, linewidth=1, label=f"{label}, 90 %")
    ax.set(
        xlabel="time into the chunk [s]",
        ylabel="error [standard deviations of the action]",
        title="Error over the horizon",
        ylim=(0, None),
    )
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8)
