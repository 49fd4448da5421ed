"""The diagnosis as a picture."""

from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from lerobot_act_chunking.diagnostics.core.episodes import evenly
from lerobot_act_chunking.diagnostics.data.report import DataReport

MOST_EPISODES, MOST_DIMENSIONS = 60, 30
MOVES, IDLE, PAUSE, ODD = "tab:blue", "0.8", "tab:orange", "0.6"


def plot_report(report: DataReport, path: Path) -> Path:
    """Rests, lags, ways, and what stands still or repeats, into a PNG; returns its path."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 9), layout="constrained")
    recording = report.recording
    size = f"{len(recording.episodes)} episodes, {recording.frames} frames at {recording.fps:g} a second"
    figure.suptitle(f"{Path(recording.folder).name}: {size}; {report.verdict}")
    (rests, lags), (ways, shares) = figure.subplots(2, 2)
    _draw_rests(rests, report)
    _draw_lags(lags, report)
    _draw_ways(ways, report)
    if report.findings.cameras:
        _draw_cameras(shares, report)
    else:
        _draw_ends(shares, report)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)
    return path


def _draw_rests(ax: Any, report: DataReport) -> None:
    """Each episode as a bar in time."""
    recording, fps = report.recording, report.recording.fps
    chosen = evenly(len(recording.episodes), MOST_EPISODES)
    for row, each in enumerate(chosen):
        rest, frames = report.findings.actions.stillness[each], len(recording.episodes[each])
        ax.broken_barh([(0, frames / fps)], (row - 0.4, 0.8), color=MOVES)
        ends = [(0, rest.start / fps), ((frames - rest.end) / fps, rest.end / fps)]
        ax.broken_barh(ends, (row - 0.4, 0.8), color=IDLE)
        ax.broken_barh([(a / fps, n / fps) for a, n in rest.pauses], (row - 0.4, 0.8), color=PAUSE)
    for label, colour in (("in motion", MOVES), ("idle", IDLE), ("pause", PAUSE)):
        ax.barh(0, 0, color=colour, label=label)
    ticks = evenly(len(chosen), 10)
    ax.set_yticks(ticks, [str(recording.episodes[chosen[each]].index) for each in ticks])
    longest = max(report.findings.lengths_s)
    ax.set(xlim=(0, 1.4 * longest), xlabel="time [s]", ylabel="episode", title="When demonstrators act")
    ax.invert_yaxis()
    ax.legend(loc="center right")


def _draw_lags(ax: Any, report: DataReport) -> None:
    tracking = report.findings.tracking
    known = [(name, lag) for name, lag in tracking.joints.items() if lag is not None][:MOST_DIMENSIONS]
    ax.set_title("How late the state follows the command")
    if not known:
        _say(ax, tracking.note or report.findings.pair_note or "of no dimension is the lag known")
        return
    seconds = [lag.seconds for _, lag in known]
    ax.barh(range(len(known)), seconds, color=MOVES)
    for row, (_, lag) in enumerate(known):
        ax.text(lag.seconds, row, f" r {lag.correlation:.2f}", va="center", fontsize=7)
    ax.set_yticks(range(len(known)), [name for name, _ in known], fontsize=8)
    ax.set(xlabel="lag [s]", xlim=(0, 1.15 * max([*seconds, 1 / report.recording.fps])))
    ax.invert_yaxis()


def _draw_ways(ax: Any, report: DataReport) -> None:
    """The direction in which actions vary most, over each episode's own time."""
    recording, ways = report.recording, report.findings.ways
    moving = report.findings.actions.floor.moving
    number = "too few episodes to say" if ways.number is None else str(ways.number)
    ax.set_title(f"Ways to do the task: {number}")
    if not moving:
        _say(ax, "no action moves")
        return
    whole = np.concatenate(recording.actions)[:, moving]
    centre, scale = whole.mean(0), whole.std(0)
    axis = np.linalg.svd((whole - centre) / scale, full_matrices=False)[2][0]
    group_of = {episode: place for place, group in enumerate(ways.groups) for episode in group}
    for each, rest in zip(recording.episodes, report.findings.actions.stillness, strict=True):
        rows = each.action[rest.start : len(each) - rest.end, moving]
        group = group_of.get(each.index)
        colour = f"C{group}" if group is not None else MOVES if ways.number is None else ODD
        along = np.linspace(0, 100, len(rows))
        ax.plot(along, (rows - centre) / scale @ axis, color=colour, linewidth=0.8, alpha=0.6)
    ax.set(
        xlabel="share of the motion [%]",
        ylabel="first principal component of the actions",
        xlim=(0, 100),
    )


def _draw_cameras(ax: Any, report: DataReport) -> None:
    """For each camera and episode how much is repeated, still or blank."""
    ax.set_title("What cameras fail to show")
    cameras = report.findings.cameras
    names = [
        f"{camera.key.removeprefix('observation.images.')} {each.episode}"
        for camera in cameras
        for each in camera.episodes
    ]
    parts = [each for camera in cameras for each in camera.episodes]
    for place, (label, name, colour) in enumerate(
        (
            ("nothing to see", "blank", "black"),
            ("equal to the one before", "repeated", PAUSE),
            ("still in motion", "still", MOVES),
        )
    ):
        at = np.arange(len(parts)) + 0.27 * (place - 1)
        ax.bar(at, [100 * getattr(each, name) for each in parts], 0.25, color=colour, label=label)
    shown = evenly(len(names), MOST_DIMENSIONS)
    ax.set_xticks(shown, [names[each] for each in shown], rotation=90, fontsize=8)
    ax.set(ylabel="frames [%]", ylim=(0, 105), xlabel="camera and episode")
    ax.legend()


def _draw_ends(ax: Any, report: DataReport) -> None:
    """Of each moving dimension the share of frames at exactly its least or greatest value."""
    ax.set_title("How long actions stand at their least or greatest value")
    found = [each for each in report.findings.actions.behaviours if each.moves][:MOST_DIMENSIONS]
    if not found:
        _say(ax, "no action moves")
        return
    rows = np.arange(len(found))
    ax.barh(rows - 0.2, [100 * each.at_low for each in found], 0.4, color=MOVES, label="least")
    ax.barh(rows + 0.2, [100 * each.at_high for each in found], 0.4, color=PAUSE, label="greatest")
    ax.set_yticks(rows, [each.name for each in found], fontsize=8)
    ax.set(xlabel="frames [%]", xlim=(0, 100))
    ax.invert_yaxis()
    ax.legend(loc="lower right")


def _say(ax: Any, text: str) -> None:
    ax.set_axis_off()
    ax.text(0.5, 0.5, fill(text, 60), ha="center", va="center")
