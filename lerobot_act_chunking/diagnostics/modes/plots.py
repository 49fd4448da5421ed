"""The diagnosis as a picture."""

from pathlib import Path
from typing import Any

import numpy as np

from lerobot_act_chunking.diagnostics.modes.report import ModesReport, SampledChunks

COLOURS = tuple(f"tab:{name}" for name in ("blue", "orange", "green", "purple", "brown", "pink", "olive"))
INVALID = "tab:red"
SHOWN = 150  # chunks


def plot_report(report: ModesReport, path: Path) -> Path:
    """How often each way is demonstrated and taken, and the sampled chunks, into a PNG; returns its path."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4.6), layout="constrained")
    figure.suptitle(f"{report.verdict}: {report.reasons[0]}", fontsize=10, wrap=True)
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    _draw_frequencies(left, report)
    if report.chunks is None:
        right.set_axis_off()
    else:
        _draw_chunks(right, report.chunks)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


def _draw_frequencies(ax: Any, report: ModesReport) -> None:
    episodes = report.episodes
    if episodes is None:
        ax.set_axis_off()
        return
    places = np.arange(len(episodes.counts) + 1)
    width = 0.27
    shown = 100 * np.array(episodes.proportions)
    ax.bar(places[:-1] - width, shown, width, color="0.75", label="demonstrated")
    shares = 100 * np.array([*episodes.shares, episodes.invalid_share])
    ax.bar(places, shares, width, color=[*_colours(len(episodes.counts)), INVALID], label="episodes")
    ends = 100 * np.array(episodes.intervals)
    errors = np.abs(ends - shares[:-1, None]).T
    ax.errorbar(places[:-1], shares[:-1], errors, fmt="none", ecolor="black", capsize=3)
    if report.chunks is not None:
        found = report.chunks.frequencies
        chunks = 100 * np.array([*found.shares, found.invalid_share])
        ax.bar(places + width, chunks, width, color="none", edgecolor="black", hatch="//", label="chunks")
    ax.set_xticks(places, [*(f"mode {mode}" for mode in places[:-1]), "none of them"])
    ax.set(ylabel="share [%], 95 % Clopper-Pearson", ylim=(0, 105))
    ax.legend(fontsize=8, frameon=False)


def _draw_chunks(ax: Any, sampled: SampledChunks) -> None:
    """Demonstrated chunks in grey and sampled ones over them, in the two dimensions that move most."""
    reference = sampled.reference
    dims = np.sort(np.argsort(-reference.chunks.std((0, 1)), kind="stable")[:2])
    for chunk in reference.chunks[:SHOWN]:
        ax.plot(*_path(chunk, dims), color="0.8", linewidth=3, zorder=1)
    chosen = np.linspace(0, len(sampled.chunks) - 1, min(SHOWN, len(sampled.chunks))).round().astype(int)
    for place in chosen:
        mode = int(sampled.modes[place])
        colour = INVALID if mode < 0 else COLOURS[mode % len(COLOURS)]
        ax.plot(*_path(sampled.chunks[place], dims), color=colour, linewidth=0.7, zorder=2)
    names = [f"action {dim} [spreads]" for dim in dims] if len(dims) > 1 else ["step", "action 0 [spreads]"]
    ax.set(xlabel=names[0], ylabel=names[1], title="chunks at the starts; red: none of the ways")
    ax.title.set_fontsize(9)


def _path(chunk: np.ndarray, dims: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    first, last = chunk[:, dims[0]], chunk[:, dims[-1]]
    return (first, last) if len(dims) > 1 else (np.arange(len(chunk)), last)


def _colours(n: int) -> list[str]:
    return [COLOURS[mode % len(COLOURS)] for mode in range(n)]
