"""The diagnosis on a terminal."""

from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lerobot_act_chunking.diagnostics.core.noise_floor import listed
from lerobot_act_chunking.diagnostics.core.terminal import COLOURS, table_of
from lerobot_act_chunking.diagnostics.data.cameras import Camera
from lerobot_act_chunking.diagnostics.data.findings import Findings, Motion
from lerobot_act_chunking.diagnostics.data.report import DataReport
from lerobot_act_chunking.diagnostics.data.ways import FEWEST_EPISODES, Ways


def print_report(report: DataReport, console: Console) -> None:
    """Print what the dataset is like, dimension by dimension, and the verdict."""
    recording, found = report.recording, report.findings
    console.print(f"[bold]Demonstrations[/] [dim]({escape(recording.folder)})[/]", soft_wrap=True)
    for line in (*_summary(report), *_rests("actions", found.actions), *_rests("states", found.states)):
        console.print(line, highlight=False, soft_wrap=True, markup=False)
    console.print(_dimensions_table(report))
    if found.cameras:
        console.print(_cameras_table(found.cameras))
    for note in report.notes:
        console.print(f"[dim]- {escape(note)}[/]", highlight=False)
    _print_split(found, console)
    colour = COLOURS[report.verdict]
    console.print(f"[{colour}]{report.verdict}[/]:", highlight=False)
    for reason in report.reasons:
        console.print(f"- {reason}", highlight=False, markup=False)


def _summary(report: DataReport) -> list[str]:
    recording, found = report.recording, report.findings
    lengths = found.lengths_s
    lines = [
        f"{len(recording.episodes)} episodes of {min(lengths):.1f} to {max(lengths):.1f} s (median "
        f"{np.median(lengths):.1f} s), {recording.frames} frames at {recording.fps:g} a second"
    ]
    lines += [
        f"time by {each.column}: {each.rate_hz:.1f} frames a second, {1000 * each.shortest_s:.0f} to "
        f"{1000 * each.longest_s:.0f} ms apart (median {1000 * each.median_s:.0f})"
        for each in found.clocks
        if not each.counted
    ]
    paces = found.actions.paces
    lines.append(
        f"pace in motion: {np.median(paces):.2g} standard deviations a second, {found.pace_spread:.1f} times "
        "as fast in the fastest tenth of the episodes as in the slowest"
    )
    return [*lines, f"ways to do the task: {_ways(found.ways)}"]


def _ways(ways: Ways) -> str:
    if ways.number is None:
        return f"too few episodes to say (it takes {FEWEST_EPISODES})"
    if ways.number == 1:
        return "1 (no gap between demonstrations)" if not ways.by_start else "1 for each kind of start"
    return f"{ways.number} ({' + '.join(str(len(group)) for group in ways.groups)} episodes)"


def _rests(name: str, motion: Motion | None) -> list[str]:
    if motion is None:
        return []
    rests, repeats = motion.rests, motion.repeats
    return [
        f"{name}: idle {rests.start_share:.1%} at the start (median {rests.start_median_s:.1f} s, longest "
        f"{rests.start_longest_s:.1f} s), {rests.end_share:.1%} at the end ({rests.end_median_s:.1f} s, "
        f"{rests.end_longest_s:.1f} s); pauses {rests.pause_share:.1%} ({rests.pauses_per_episode:.2f} an "
        f"episode, longest {rests.pause_longest_s:.1f} s); rows repeated {repeats.share:.1%} (longest "
        f"{repeats.longest_s:.1f} s); frames with jumps {motion.jump_frames}"
    ]


def _dimensions_table(report: DataReport) -> Table:
    """Actions alone: the states' figures are in the JSON."""
    found, fps = report.findings, report.recording.fps
    table = table_of("action", "range", "at an end", "jumps", "open/close", "lag")
    for each in found.actions.behaviours:
        if each.kind == "constant":
            continue
        lag = found.tracking.joints.get(each.name)
        value, share = each.at_an_end
        cells = [
            f"{each.low:.4g} to {each.high:.4g}",
            f"{value:.4g} in {share:.0%}" if share >= 0.01 else "",
            str(len(each.jumps)) if each.jumps else "",
            "" if each.events is None else f"{each.events:g}",
            ""
            if lag is None
            else f"{fps * lag.seconds:.1f} frames, {lag.seconds:.2f} s (r {lag.correlation:.2f})",
        ]
        style = None if each.moves else "dim"
        table.add_row(escape(each.name), *cells, style=style)
    return table


def _cameras_table(cameras: Sequence[Camera]) -> Table:
    table = table_of("camera", "episodes", "frames", "blank", "repeated", "still in motion")
    for camera in cameras:
        parts = camera.episodes
        shares = [[getattr(each, name) for each in parts] for name in ("blank", "repeated", "still")]
        table.add_row(
            escape(camera.key),
            str(len(parts)),
            str(sum(each.frames for each in parts)),
            *(f"{np.median(each):.0%}, at most {max(each):.0%}" for each in shares),
        )
    return table


def _print_split(found: Findings, console: Console) -> None:
    if not found.operators:
        return
    people = listed([f"{name} ({n})" for name, n in found.operators.items()], 12)
    console.print(f"demonstrated by {people}", highlight=False, markup=False)
    if found.split is not None:
        train = str(found.split.train).replace(" ", "")
        console.print(
            f"train on all but {found.split.held_out}, and validate on those {len(found.split.validation)} "
            f"episodes: --dataset.episodes='{train}'",
            highlight=False,
            markup=False,
            soft_wrap=True,
        )
