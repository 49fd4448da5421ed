"""The comparison as a picture."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_act_chunking.diagnostics.core.trajectories import JITTER_HZ
from lerobot_act_chunking.diagnostics.smoothness.chunks import PROFILE_STEPS
from lerobot_act_chunking.diagnostics.smoothness.report import SmoothnessComparison, SmoothnessReport

_DECADES = 8  # of power below the largest that are drawn


def plot_report(report: SmoothnessComparison, path: Path) -> Path:
    """Steps around chunk boundaries, spectra, disagreement and jerk of each source, into a PNG; its path."""
    from matplotlib.figure import Figure

    reports = report.sources
    figure = Figure(figsize=(11, 7.5), layout="constrained")
    boundary, spectrum, disagreement, jerk = figure.subplots(2, 2).ravel()
    colors = [f"C{i % 10}" for i in range(len(reports))]
    _draw_boundaries(boundary, reports, colors)
    _draw_spectra(spectrum, reports, colors)
    _draw_disagreement(disagreement, reports, colors)
    _draw_jerk(jerk, reports, colors)
    handles = [
        figure.axes[1].plot([], [], color=color, label=each.name)[0]
        for each, color in zip(reports, colors, strict=True)
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=min(3, len(reports)))
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


def _draw_boundaries(ax: Any, reports: Sequence[SmoothnessReport], colors: Sequence[str]) -> None:
    offsets = np.arange(-PROFILE_STEPS, PROFILE_STEPS + 1)
    drawn = False
    for report, color in zip(reports, colors, strict=True):
        profile = report.curves.boundary_profile
        if profile is not None:
            ax.plot(offsets * report.dt * 1000, profile, ".-", color=color)
            drawn = True
    ax.set(
        title="Commanded steps around a chunk boundary", xlabel="time from the new chunk's first step [ms]"
    )
    ax.set_ylabel("median step / usual step")
    ax.axvline(0, color="0.6", linewidth=0.8, linestyle="--")
    if drawn:
        ax.set_ylim(bottom=0)
    else:
        _say(ax, "no boundaries, or too close together")


def _draw_spectra(ax: Any, reports: Sequence[SmoothnessReport], colors: Sequence[str]) -> None:
    largest = 0.0
    for report, color in zip(reports, colors, strict=True):
        curves = report.curves
        ax.semilogy(curves.frequencies_hz, curves.commanded_power, color=color)
        if curves.achieved_power is not None:
            ax.semilogy(curves.frequencies_hz, curves.achieved_power, color=color, linestyle=":")
        largest = max(largest, *curves.commanded_power)
    ax.axvline(JITTER_HZ, color="0.6", linewidth=0.8, linestyle="--")
    ax.set(
        title="Spectrum of the velocity (dotted: achieved)",
        xlabel="frequency [Hz]",
        ylabel="power density [std²/s²/Hz]",
        xlim=(0, None),
    )
    if largest > 0:
        ax.set_ylim(largest * 10**-_DECADES, largest * 3)


def _draw_disagreement(ax: Any, reports: Sequence[SmoothnessReport], colors: Sequence[str]) -> None:
    drawn = False
    for report, color in zip(reports, colors, strict=True):
        found = report.disagreement
        if found is not None:
            ax.plot(found.ages_s, found.arms, ".-", color=color)
            drawn = True
    ax.set(
        title="Disagreement of overlapping chunks", xlabel="age between the chunks [s]", ylabel="rms [std]"
    )
    if drawn:
        ax.set_ylim(bottom=0)
        ax.set_xlim(left=0)
    else:
        _say(ax, "no overlapping chunks were logged")


def _draw_jerk(ax: Any, reports: Sequence[SmoothnessReport], colors: Sequence[str]) -> None:
    """One box per source, of the episodes."""
    for row, (report, color) in enumerate(zip(reports, colors, strict=True)):
        values = [value for value in report.curves.log_dimensionless_jerk if value is not None]
        if values:
            box = ax.boxplot(values, positions=[row], orientation="horizontal", widths=0.5, patch_artist=True)
            box["boxes"][0].set(facecolor=color, alpha=0.5)
            box["medians"][0].set_color("black")
    ax.set(title="Commanded smoothness, per episode", xlabel="log dimensionless jerk (right is smoother)")
    ax.set_yticks([])
    ax.set_ylim(len(reports) - 0.5, -0.5)


def _say(ax: Any, text: str) -> None:
    ax.text(0.5, 0.5, text, ha="center", va="center", transform=ax.transAxes, color="0.4")
    ax.set(xticks=[], yticks=[], xlabel="", ylabel="")
