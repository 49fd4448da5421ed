"""The comparison of tokenizers as a picture."""

from pathlib import Path
from typing import Any

import numpy as np

from lerobot_act_chunking.diagnostics.codebook.comparison.report import ComparisonReport

_MARKERS = {"residual_vq": "o", "fsq": "s", "dct": "^", "uniform": "D"}


def plot_report(report: ComparisonReport, path: Path) -> Path:
    """What is lost against bits, and where it is lost, into a PNG; returns its path."""
    from matplotlib.figure import Figure

    n_dims = len(report.demonstrations.names)
    figure = Figure(figsize=(14, 3.5 + 0.18 * max(n_dims, 8)), layout="constrained")
    seconds = report.timing.control_steps / report.demonstrations.fps
    figure.suptitle(
        f"Tokenizers for chunks of {report.timing.chunk_size} actions, {seconds:.2g} s; "
        f"errors on {len(report.held_out)} episodes held out"
    )
    bits, dimensions = figure.subplots(1, 2, width_ratios=(1, 1.3))
    _draw_bits(bits, report)
    _draw_dimensions(dimensions, report)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


def _draw_bits(ax: Any, report: ComparisonReport) -> None:
    for i, (kind, marker) in enumerate(_MARKERS.items()):
        of_kind = [each for each in report.fitted if each.candidate.kind == kind]
        x = [each.bits for each in of_kind]
        y = [100 * each.losses.lost_variance for each in of_kind]
        ax.plot(x, y, marker, color=f"C{i}", label=kind, linestyle=":", linewidth=1)
        for each, at, lost in zip(of_kind, x, y, strict=True):
            label = each.candidate.name.removeprefix(f"{kind} ")
            right, below = kind != "residual_vq", kind in ("fsq", "dct")  # where others are not
            place = (6 if right else -6, -4 if below else 3)
            aligned = {"ha": "left" if right else "right", "va": "top" if below else "bottom"}
            style = {"fontsize": 8, "color": f"C{i}", **aligned}
            ax.annotate(label, (at, lost), place, textcoords="offset points", **style)
    allowed = 100 * report.thresholds.lost_variance[0]
    ax.axhline(allowed, color="black", linewidth=1, linestyle=(0, (6, 2, 1, 2)), label="allowed")
    best = report.recommended
    ax.plot(
        [best.bits],
        [100 * best.losses.lost_variance],
        "o",
        markersize=15,
        markerfacecolor="none",
        color="black",
        label="recommended",
    )
    ax.set(xscale="log", yscale="log", xlabel="bits per chunk", ylabel="variance lost [%]")
    ax.xaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_major_formatter("{x:g}")
    ax.margins(x=0.18, y=0.1)
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8)


def _draw_dimensions(ax: Any, report: ComparisonReport) -> None:
    """Mean error of each dimension and tokenizer in raw units; the colour is the share of variance lost."""
    losses = [each.losses.dimensions for each in report.fitted]
    shares = np.array(
        [[np.nan if loss.lost_variance is None else loss.lost_variance for loss in of] for of in losses]
    )
    image = ax.imshow(100 * np.clip(shares.T, 0, 1), aspect="auto", cmap="Blues", vmin=0, vmax=100)
    for column, of in enumerate(losses):
        for row, loss in enumerate(of):
            dark = (loss.lost_variance or 0) > 0.6
            ax.text(
                column,
                row,
                f"{loss.mean:.1g}" if loss.mean < 1 else f"{loss.mean:.3g}",
                ha="center",
                va="center",
                fontsize=8,
                color="white" if dark else "black",
            )
    names = [each.candidate.name for each in report.fitted]
    ax.set_xticks(range(len(names)), names, rotation=40, ha="right", fontsize=8)
    ax.set_yticks(range(len(losses[0])), [loss.name for loss in losses[0]], fontsize=8)
    ax.set_title("mean absolute error [raw units]", fontsize=10)
    ax.figure.colorbar(image, ax=ax, label="variance of the dimension lost [%]")
