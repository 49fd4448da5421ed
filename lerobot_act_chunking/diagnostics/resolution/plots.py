"""The diagnosis as a picture."""

from pathlib import Path
from typing import Any

import numpy as np

from lerobot_act_chunking.diagnostics.resolution.report import ResolutionReport
from lerobot_act_chunking.diagnostics.resolution.verdict import MOST_ABOVE_NYQUIST

LEAST_SHARE = 1e-7
_RECOMMENDED = "tab:green"


def plot_report(report: ResolutionReport, path: Path) -> Path:
    """Error by stride, energy by frequency, and the worst moment, into a PNG; returns its path."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 4.6), layout="constrained")
    stride = report.recommended.stride
    judged = "" if report.judged is report.recommended else f"chunk_stride={report.judged.stride}: "
    figure.suptitle(
        f"{judged}{report.verdict}; chunk_stride={stride} is the largest within {report.tolerance}"
    )
    errors, energy = figure.subplots(1, 2)
    _draw_errors(errors, report)
    _draw_energy(energy, report)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


def _draw_errors(ax: Any, report: ResolutionReport) -> None:
    """Deviation by stride; the smallest stride, which loses nothing, is not on the logarithmic axis."""
    lossy = [stride for stride in report.strides if stride.stride > 1]
    x = [stride.stride for stride in lossy]
    scale, unit = (1, "mm") if report.tolerance.unit == "mm" else (100, "% of its range")
    farthest = [stride.reconstruction.farthest for stride in lossy]
    if report.tolerance.unit == "mm":
        ax.plot(x, [each and each.max for each in farthest], ":", color="tab:blue", label="max")
        ax.plot(x, [each and each.rms for each in farthest], "--", color="tab:blue", label="rms")
    ax.plot(x, [scale * stride.worst for stride in lossy], "o-", color="tab:blue", label="95 % of the steps")
    ax.axhline(
        scale * report.tolerance.value, color="gray", linewidth=1, label=f"allowed: {report.tolerance}"
    )
    ax.axvline(report.recommended.stride, color=_RECOMMENDED, linewidth=1.5, label="recommended")
    ax.set(
        xscale="log",
        yscale="log",
        xlabel="chunk_stride [control steps]",
        ylabel=f"farthest gripper [{unit}]" if unit == "mm" else f"worst dimension [{unit}]",
        title="What interpolation loses",
    )
    ax.set_xticks(x, [str(each) for each in x])
    ax.minorticks_off()
    ax.yaxis.set_major_formatter("{x:g}")
    ax.grid(alpha=0.3)
    ax.legend()


def _draw_energy(ax: Any, report: ResolutionReport) -> None:
    spectrum = report.spectrum
    frequencies = spectrum.frequencies[1:]
    shares = np.stack([spectrum.above(frequency) for frequency in frequencies])  # (F, A)
    for dim in np.flatnonzero(spectrum.moves):
        label = "each dimension" if dim == np.flatnonzero(spectrum.moves)[0] else None
        ax.plot(frequencies, shares[:, dim], color="tab:blue", alpha=0.3, linewidth=1, label=label)
    together = [spectrum.all_above(frequency) for frequency in frequencies]
    ax.plot(frequencies, together, color="black", label="all, to equal parts")
    ax.axhline(MOST_ABOVE_NYQUIST, color="gray", linewidth=1, label=f"allowed: {MOST_ABOVE_NYQUIST:.0%}")
    for stride in report.strides:
        chosen = stride is report.recommended
        colour = _RECOMMENDED if chosen else "gray"
        ax.axvline(
            stride.nyquist_hz, color=colour, linewidth=1.5 if chosen else 0.5, alpha=1 if chosen else 0.6
        )
    ax.set(
        xscale="log",
        yscale="log",
        ylim=(LEAST_SHARE, 1.5),
        xlim=(frequencies[0], frequencies[-1]),
        xlabel="frequency [Hz]; lines: half the rate of predictions",
        ylabel="share of the energy above it",
        title="How fast demonstrations move; above: chunk_stride",
    )
    top = ax.secondary_xaxis("top")
    top.set_xticks(
        [s.nyquist_hz for s in report.strides], [str(s.stride) for s in report.strides], fontsize=7
    )
    top.minorticks_off()
    ax.xaxis.set_major_formatter("{x:g}")
    ax.grid(alpha=0.3)
    ax.legend(loc="lower left")
