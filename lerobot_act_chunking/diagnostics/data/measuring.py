"""From a recording to a `DataReport`."""

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from lerobot_act_chunking.data.action_kind import asks_for_changes
from lerobot_act_chunking.diagnostics.core.noise_floor import measure_noise
from lerobot_act_chunking.diagnostics.core.recording import Recording
from lerobot_act_chunking.diagnostics.core.stillness import find_stillness, summarise
from lerobot_act_chunking.diagnostics.core.tracking import Tracking, track
from lerobot_act_chunking.diagnostics.data.cameras import Camera
from lerobot_act_chunking.diagnostics.data.clocks import read_clocks
from lerobot_act_chunking.diagnostics.data.dimensions import find_behaviours, find_repeats
from lerobot_act_chunking.diagnostics.data.findings import Findings, Motion
from lerobot_act_chunking.diagnostics.data.operators import split_by_operator
from lerobot_act_chunking.diagnostics.data.pairing import Pairs, pair_dimensions
from lerobot_act_chunking.diagnostics.data.report import DataReport
from lerobot_act_chunking.diagnostics.data.verdict import judge
from lerobot_act_chunking.diagnostics.data.ways import Ways, count_ways
from lerobot_act_chunking.errors import DatasetError


def sound(recording: Recording) -> Recording:
    """The episodes without a NaN or an infinity.

    Raises:
        DatasetError: there are none.
    """
    kept = tuple(each for each in recording.episodes if not each.broken)
    if not kept:
        raise DatasetError(
            f"every episode of {recording.folder} holds a NaN or an infinity in its actions or states: "
            "record it anew, or mend these values"
        )
    operators = {each.index: name for each in kept if (name := recording.operators.get(each.index))}
    return Recording(
        recording.folder,
        recording.fps,
        recording.action_names,
        recording.state_names,
        kept,
        operators,
    )


def measure_motion(
    rows: Sequence[np.ndarray], indices: Sequence[int], fps: float, names: Sequence[str]
) -> Motion:
    """What the actions do, or the states: (L, D) of each episode."""
    floor = measure_noise(rows, fps, names)
    moving = floor.moving
    scale = np.concatenate(rows).std(0)[moving]
    stillness = [find_stillness(each[:, moving], scale, fps) for each in rows]
    return Motion(
        floor=floor,
        behaviours=find_behaviours(rows, indices, floor),
        stillness=stillness,
        rests=summarise(stillness, fps),
        repeats=find_repeats(rows, [each.idle for each in stillness], fps),
    )


def measure(
    recording: Recording, actions: Motion, broken: dict[int, list[str]], cameras: list[Camera]
) -> DataReport:
    """Measure a dataset and judge it.

    Args:
        recording: its sound episodes.
        actions: what is commanded in them.
        broken: columns of the others that hold a NaN or an infinity, by episode.
        cameras: what they show.
    """
    indices = [each.index for each in recording.episodes]
    has_states = bool(len(recording.state_names))
    states = (
        measure_motion(recording.states, indices, recording.fps, recording.state_names)
        if has_states
        else None
    )
    tracking, pairs = _track(recording, actions)
    findings = Findings(
        lengths_s=[len(each) / recording.fps for each in recording.episodes],
        broken=broken,
        clocks=read_clocks(recording),
        actions=actions,
        states=states,
        tracking=tracking,
        pair_note=pairs.note,
        changes=has_states and _asks_for_changes(recording),
        ways=_ways(recording, actions),
        cameras=cameras,
        operators=dict(sorted(Counter(recording.operators.values()).items())),
        split=split_by_operator(recording.operators),
    )
    return DataReport(recording=recording, findings=findings, judgement=judge(recording, findings))


def _track(recording: Recording, actions: Motion) -> tuple[Tracking, Pairs]:
    """Lags of all dimensions that have a state, up to half an episode."""
    commands, positions = np.concatenate(recording.actions), np.concatenate(recording.states)
    pairs = pair_dimensions(commands, positions, recording.action_names, recording.state_names)
    if not pairs.actions:
        return Tracking({}, {}), pairs
    moving = set(actions.floor.moving)
    tracking = track(
        [rows[:, pairs.actions] for rows in recording.actions],
        [rows[:, pairs.states] for rows in recording.states],
        1 / recording.fps,
        [recording.action_names[dim] for dim in pairs.actions],
        {},
        [place for place, dim in enumerate(pairs.actions) if dim in moving],
        reach_s=math.inf,
    )
    return tracking, pairs


def _asks_for_changes(recording: Recording) -> bool:
    episode = np.repeat(np.arange(len(recording.episodes)), [len(each) for each in recording.episodes])
    return asks_for_changes(np.concatenate(recording.states), np.concatenate(recording.actions), episode)


def _ways(recording: Recording, actions: Motion) -> Ways:
    """Of the motions alone, without the rests before and after them."""
    moving = actions.floor.moving
    if not moving:
        return Ways(None)
    motions = [
        rows[each.start : len(rows) - each.end, moving]
        for rows, each in zip(recording.actions, actions.stillness, strict=True)
    ]
    scale = np.concatenate(recording.actions).std(0)[moving]
    starts = np.stack([rows[0, moving] / scale for rows in recording.actions])
    return count_ways(motions, starts, scale, [each.index for each in recording.episodes])
