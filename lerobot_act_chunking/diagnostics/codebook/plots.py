"""The diagnosis as a picture."""

from pathlib import Path
from typing import Any

import numpy as np

from lerobot_act_chunking.diagnostics.codebook.meaning import MOST_CODES, TENTHS, CodeUse
from lerobot_act_chunking.diagnostics.codebook.report import CodebookReport
from lerobot_act_chunking.diagnostics.codebook.terminal import describe
from lerobot_act_chunking.diagnostics.core.measures import RawUnits

MOST_LEVELS = 4
COLUMNS = 6
MOST_NAMES = 8
_POINT_COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:red")


def plot_report(report: CodebookReport, path: Path) -> Path:
    """Usage, errors, when codes are used and what they do, into a PNG; returns its path."""
    from matplotlib.figure import Figure

    drawn = report.uses[:MOST_CODES]
    rows = -(-len(drawn) // COLUMNS)
    height = 2.5 if isinstance(report.measure, RawUnits) else 1.9
    figure = Figure(figsize=(15, 4.4 + height * rows), layout="constrained")
    figure.suptitle(f"{describe(report.subject, report.demonstrations.fps)}: {report.verdict}")
    upper: Any = figure
    if rows:
        parts: Any = figure.subfigures(2, 1, height_ratios=(4, height * rows))
        upper, lower = parts
        _draw_codes(lower, report, drawn)
    usage, errors, last = upper.subplots(1, 3, width_ratios=(1, 1.1, 1))
    _draw_usage(usage, report)
    _draw_errors(errors, report)
    if report.uses:
        _draw_timeline(last, report)
    else:
        _draw_chunk_errors(last, report)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


def _draw_usage(ax: Any, report: CodebookReport) -> None:
    """Shares of each level's values, the most frequent first; dotted: of the other data, same order."""
    vocabulary = report.usage.vocabulary
    rank = np.arange(1, vocabulary + 1)
    for i, level in enumerate(report.usage.levels[:MOST_LEVELS]):
        counts = np.array(level.counts)
        order = np.argsort(-counts, kind="stable")
        line = ax.step(
            rank,
            counts[order] / counts.sum(),
            where="mid",
            label=f"level {i + 1}: {level.used} used, perplexity {level.perplexity:.1f}",
        )
        if report.other is not None:
            others = np.bincount(report.other.codes[:, i], minlength=vocabulary)
            ax.plot(rank, others[order] / others.sum(), ".", color=line[0].get_color(), markersize=5)
    if report.other is not None:
        ax.plot([], [], ".", color="0.3", label="the other data")
    ax.axhline(1 / vocabulary, color="0.6", linewidth=0.8, linestyle="--")
    ax.set(xlabel="values of the code, most frequent first", ylabel="share of the chunks", title="Usage")
    ax.set_ylim(bottom=0)
    ax.xaxis.get_major_locator().set_params(integer=True)
    ax.legend(fontsize=8)


def _draw_errors(ax: Any, report: CodebookReport) -> None:
    dimensions = report.losses.dimensions
    at = np.arange(len(dimensions))
    ax.barh(at, [loss.p95 for loss in dimensions], height=0.75, color="0.8", label="95 %")
    ax.barh(at, [loss.mean for loss in dimensions], height=0.75, color="tab:blue", label="mean")
    if report.other is not None:
        means = np.nanmean(report.other.errors, axis=(0, 1))
        ax.plot(means, at, "|", color="tab:red", markersize=10, markeredgewidth=2, label="mean, other data")
    ax.set_yticks(at, [loss.name for loss in dimensions], fontsize=8)
    ax.invert_yaxis()
    lost = f"{report.losses.lost_variance:.1%} of the variance lost"
    ax.set(xlabel="absolute error of the codes alone [raw units]", title=f"Reconstruction: {lost}")
    ax.legend(fontsize=8, loc="lower right")


def _draw_timeline(ax: Any, report: CodebookReport) -> None:
    """Which share of the chunks has each value, by where in the episode they begin."""
    uses = sorted(report.uses[: 2 * MOST_CODES], key=lambda use: use.progress[1])
    shares = np.array([use.timeline for use in uses])
    image = ax.imshow(
        100 * shares, aspect="auto", cmap="Blues", extent=(0, 100, len(uses) - 0.5, -0.5), vmin=0, vmax=100
    )
    ax.set_yticks(range(len(uses)), [str(use.code) for use in uses], fontsize=8)
    ax.set_xticks(np.linspace(0, 100, TENTHS // 2 + 1))
    ax.set(xlabel="place in the episode [%]", ylabel="first code", title="When the first codes are used")
    ax.figure.colorbar(image, ax=ax, label="share of the chunks [%]")


def _draw_chunk_errors(ax: Any, report: CodebookReport) -> None:
    sets = {"training data": report.coded, "the other data": report.other}
    for name, coded in sets.items():
        if coded is not None:
            errors = np.sort(coded.chunk_errors)
            ax.plot(errors, np.linspace(0, 100, len(errors)), label=name)
    ax.set(xlabel="RMS error of a chunk [normalised units]", ylabel="share of the chunks [%]")
    ax.set(title="Errors of chunks")
    ax.legend(fontsize=8)


def _draw_codes(figure: Any, report: CodebookReport, uses: list[CodeUse]) -> None:
    """A panel for each of the most frequent first codes: what its most frequent combinations stand for."""
    rows = -(-len(uses) // COLUMNS)
    axes = figure.subplots(rows, COLUMNS, sharex=True, sharey=True, squeeze=False).ravel()
    draw = _draw_motions if isinstance(report.measure, RawUnits) else _draw_paths
    for ax, use in zip(axes, uses, strict=False):
        draw(ax, report, use)
        ax.set_title(f"code {use.code}: {use.share:.0%} of the chunks", fontsize=9)
    for ax in axes[len(uses) :]:
        ax.set_axis_off()
    handles, labels = axes[0].get_legend_handles_labels()
    if len(labels) <= MOST_NAMES:
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=9)


def _draw_paths(ax: Any, report: CodebookReport, use: CodeUse) -> None:
    """Where the points go, from the side; thick: the most frequent combination."""
    points = report.measure.points(use.decoded)  # (n, C, P, 3)
    for point, name in enumerate(report.measure.names):
        colour = _POINT_COLOURS[point % len(_POINT_COLOURS)]
        for i, path in enumerate(points[::-1, :, point]):
            is_first = i == len(points) - 1
            ax.plot(
                path[:, 0],
                path[:, 2],
                color=colour,
                linewidth=2 if is_first else 0.7,
                label=name if is_first else None,
            )
            ax.plot(path[-1, 0], path[-1, 2], "o", color=colour, markersize=4 if is_first else 1.5)
    ax.set_aspect("equal")
    _label_outer(ax, f"x [{report.measure.unit}]", f"height [{report.measure.unit}]")


def _draw_motions(ax: Any, report: CodebookReport, use: CodeUse) -> None:
    """All dimensions of the most frequent combination over time, in standard deviations from their mean."""
    timing, fps = report.subject.coder.timing, report.demonstrations.fps
    valid = report.coded.chunks.actions[~report.coded.chunks.is_pad]
    mean, std = valid.mean(0), np.maximum(valid.std(0), 1e-6)
    time = np.arange(timing.chunk_size) * timing.chunk_stride / fps
    for i, chunk in enumerate(use.decoded[::-1]):
        is_first = i == len(use.decoded) - 1
        for dim, values in enumerate(((chunk - mean) / std).T):
            label = report.demonstrations.names[dim] if is_first else None
            style = {"linewidth": 2 if is_first else 0.5, "alpha": 1 if is_first else 0.5}
            ax.plot(time, values, color=f"C{dim % 10}", label=label, **style)
    _label_outer(ax, "time in the chunk [s]", "action [sd]")


def _label_outer(ax: Any, x: str, y: str) -> None:
    ax.set(xlabel=x, ylabel=y)
    ax.label_outer()
    ax.grid(alpha=0.3)
