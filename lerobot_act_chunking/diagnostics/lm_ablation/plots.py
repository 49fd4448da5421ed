"""The comparison as a picture."""

from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from lerobot_act_chunking.diagnostics.lm_ablation.cells import REFERENCE
from lerobot_act_chunking.diagnostics.lm_ablation.effects import Effect
from lerobot_act_chunking.diagnostics.lm_ablation.report import LmAblationReport

STYLES = {
    "T-LM'": ("tab:blue", "-"),
    "T-R": ("tab:blue", ":"),
    "M-LM'": ("tab:orange", "-"),
    "M-R": ("tab:orange", ":"),
    "T-LM": ("tab:green", "-"),
}


def plot_report(report: LmAblationReport, path: Path) -> Path:
    """Success by demonstrations, learning curves, and every effect, into a PNG; returns its path."""
    from matplotlib.figure import Figure

    conditions = list(report.settings.conditions)
    overall = _overall(report)
    names = list(dict.fromkeys(each.name for each in overall))
    figure = Figure(figsize=(4.2 * max(2, len(conditions)), 6.5 + 0.24 * len(names)), layout="constrained")
    parts: Any = figure.subfigures(2, 1, height_ratios=[4, 1.5 + 0.27 * len(names)])
    above, below = parts
    axes = np.atleast_1d(above.subplots(1, len(conditions) + 1))
    for ax, condition in zip(axes, conditions, strict=False):
        _draw_success(ax, report, condition)
    _draw_curves(axes[-1], report)
    axes[0].legend(fontsize=7)
    bars = np.atleast_1d(below.subplots(1, len(conditions), sharey=True))
    for ax, condition in zip(bars, conditions, strict=True):
        _draw_effects(ax, [each for each in overall if each.condition == condition], names, condition)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)
    return path


def _overall(report: LmAblationReport) -> list[Effect]:
    """The effects over all sizes, or of the only one."""
    several = any(each.size is None for each in report.effects)
    return [each for each in report.effects if (each.size is None) == several]


def _draw_success(ax: Any, report: LmAblationReport, condition: str) -> None:
    for cell, (colour, line) in STYLES.items():
        rows = [each for each in report.rows if each.cell == cell]
        if rows:
            rates = [100 * each.success[condition] for each in rows]
            ax.plot(
                [each.size for each in rows], rates, line, marker="o", markersize=3, color=colour, label=cell
            )
    ax.set(xlabel="demonstrations", ylabel="success [%]", ylim=(0, 102), title=condition)
    ax.set_xscale("log")
    ax.set_xticks(report.settings.sizes, [str(each) for each in report.settings.sizes])
    ax.minorticks_off()
    ax.grid(alpha=0.3)


def _draw_curves(ax: Any, report: LmAblationReport) -> None:
    largest = max((each.size for each in report.records), default=0)
    for cell, (colour, line) in STYLES.items():
        curves = [each.curve for each in report.records if each.cell == cell and each.size == largest]
        if curves:
            steps = [step for step, _ in curves[0]]
            losses = [fmean(curve[place][1] for curve in curves) for place in range(len(steps))]
            ax.plot(steps, losses, line, color=colour, label=cell)
    ax.set(xlabel="training steps", ylabel="validation loss", title=f"{largest} demonstrations")
    ax.set_yscale("log")
    ax.grid(alpha=0.3)


def _draw_effects(ax: Any, effects: Sequence[Effect], names: Sequence[str], condition: str) -> None:
    for found in effects:
        place = names.index(found.name)
        colour = "tab:green" if found.decided else "tab:gray"
        ax.plot([100 * end for end in found.interval], [place] * 2, color=colour, linewidth=2)
        ax.plot(100 * found.value, place, "o", color=colour, markersize=4)
    ax.axvline(0, color="gray", linewidth=1)
    labels = [f"{name} - {REFERENCE}" if name in STYLES or "-" in name else name for name in names]
    ax.set_yticks(range(len(names)), labels, fontsize=7)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set(xlabel="points, 95 %; green: leaves out zero", title=condition)
    ax.title.set_fontsize(9)
    ax.grid(axis="x", alpha=0.3)
