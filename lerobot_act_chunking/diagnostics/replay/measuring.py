"""From a policy and a recording to a `ReplayReport`."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_act_chunking.data.dimension_names import is_hand
from lerobot_act_chunking.diagnostics.core.episodes import evenly
from lerobot_act_chunking.diagnostics.core.noise_floor import NoiseFloor, measure_noise
from lerobot_act_chunking.diagnostics.core.recorded import chunks_at, commands_at, nearest_rows, observations
from lerobot_act_chunking.diagnostics.core.recording import Recording
from lerobot_act_chunking.diagnostics.replay.execution import Gripper, find_hesitations, time_gripper
from lerobot_act_chunking.diagnostics.replay.horizon import (
    Chunks,
    by_person,
    measure_following,
    measure_horizon,
)
from lerobot_act_chunking.diagnostics.replay.report import Drawn, ReplayReport
from lerobot_act_chunking.diagnostics.replay.settings import Settings
from lerobot_act_chunking.diagnostics.replay.verdict import judge
from lerobot_act_chunking.errors import ConfigurationError, DatasetError
from lerobot_act_chunking.policies.loading import LoadedPolicy

MOST_EPISODES = 20
"""Without ``episodes``: more are thinned out evenly."""
MOST_DRAWN = 12  # chunks in the picture
SPAN = 0.01, 0.99  # quantiles between which a gripper opens


@dataclass(frozen=True)
class Subject:
    """What is replayed.

    Attributes:
        policy: in evaluation mode.
        policy_type: of the checkpoint.
        dataset: to read observations from.
        recording: its numbers.
        episodes: to replay.
        learned: all episodes that the policy was trained on.
    """

    policy: LoadedPolicy
    policy_type: str
    dataset: LeRobotDataset
    recording: Recording
    episodes: list[int]
    learned: list[int]


def choose(there: Sequence[int], learned: Sequence[int], settings: Settings) -> list[int]:
    """The episodes to replay: those that are asked for, else unseen ones, else any.

    Raises:
        ConfigurationError: one that is asked for is not there.
    """
    missing = sorted({*settings.episodes} - {*there})
    if missing:
        raise ConfigurationError(
            f"episodes={','.join(map(str, missing))}: the dataset at {settings.dataset} has no such "
            f"episodes, but {len(there)}, from {there[0]} to {there[-1]}"
        )
    if settings.episodes:
        return sorted({*settings.episodes})
    unseen = [each for each in there if each not in learned] or list(there)
    return [unseen[at] for at in evenly(len(unseen), MOST_EPISODES)]


def measure(subject: Subject, settings: Settings) -> ReplayReport:
    """Ask the policy for chunks, execute them, and hold both against what was done.

    Raises:
        DatasetError: no frame can be asked about.
    """
    recording = subject.recording
    floor = measure_noise(recording.actions, recording.fps, recording.action_names)
    chunks = _ask(subject, settings.observations)
    actions, moving = np.concatenate(recording.actions), floor.moving
    following = people = hesitations = None
    grippers: list[Gripper] = []
    if moving:
        rng = np.random.default_rng(settings.seed)
        following = measure_following(chunks, actions, moving, recording.fps, rng)
        people = by_person(chunks, recording.operators, actions.std(0), moving)
        pairs = _execute(subject)
        hesitations = find_hesitations(
            [(ours[:, moving], theirs[:, moving]) for ours, theirs in pairs],
            actions.std(0)[moving],
            recording.fps,
        )
        grippers = _grippers(floor, pairs, actions, recording)
    learned = sorted({*subject.episodes} & {*subject.learned})
    return ReplayReport(
        requested=settings,
        policy_type=subject.policy_type,
        fps=recording.fps,
        names=list(recording.action_names),
        episodes=subject.episodes,
        learned=learned,
        n_observations=len(chunks.episode),
        spread=actions.std(0),
        floor=floor,
        horizon=measure_horizon(chunks),
        following=following,
        grippers=grippers,
        hesitations=hesitations,
        people=people or {},
        drawn=_draw(subject, chunks.predicted.shape[1]),
        judgement=judge(
            following, grippers, hesitations, recording.action_names, bool(learned), len(chunks.episode)
        ),
    )


def _rows(recording: Recording) -> dict[int, tuple[int, int]]:
    """First row and length of each episode."""
    lengths = [len(each) for each in recording.episodes]
    starts = np.cumsum([0, *lengths[:-1]]).tolist()
    return {
        each.index: (start, length)
        for each, start, length in zip(recording.episodes, starts, lengths, strict=True)
    }


def _ask(subject: Subject, most: int) -> Chunks:
    """Chunks at frames that have one before them."""
    recording, rows = subject.recording, _rows(subject.recording)
    spans = [np.arange(rows[each][0] + 1, sum(rows[each])) for each in subject.episodes]
    frames = np.concatenate(spans)
    if not len(frames):
        raise DatasetError(f"episodes of a single frame show no motion: {subject.episodes}")
    frames = frames[evenly(len(frames), most)]
    predicted = chunks_at(subject.policy, subject.dataset, frames)
    steps = predicted.shape[1]
    episode = np.repeat(
        [each.index for each in recording.episodes], [len(each) for each in recording.episodes]
    )
    actions = np.concatenate(recording.actions)
    demonstrated, inside = _ahead(actions, episode, frames, steps)
    last = actions[frames - 1]
    seen = _vectors(subject.dataset)
    nearest = None
    if len(recording.episodes) > 1 and seen is not None:
        nearest, _ = _ahead(actions, episode, nearest_rows(seen, episode, frames), steps)
    return Chunks(
        episode=episode[frames],
        predicted=predicted,
        demonstrated=np.where(inside[..., None], demonstrated, np.nan),
        still=np.repeat(_still(recording, frames, last)[:, None], steps, axis=1),
        last=last,
        nearest=nearest,
    )


def _ahead(
    actions: np.ndarray, episode: np.ndarray, frames: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Actions (M, T, A) from these frames on, the last one kept, and which are within the episode (M, T)."""
    ends = np.searchsorted(episode, episode[frames], side="right") - 1
    rows = frames[:, None] + np.arange(steps)
    return actions[np.minimum(rows, ends[:, None])], rows <= ends[:, None]


def _still(recording: Recording, frames: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Where the robot is (M, A), as far as states have the names of actions; elsewhere the last action."""
    names, states = list(recording.state_names), np.concatenate(recording.states)
    still = last.copy()
    for dim, name in enumerate(recording.action_names):
        if name in names:
            still[:, dim] = states[frames, names.index(name)]
    return still


def _vectors(dataset: LeRobotDataset) -> np.ndarray | None:
    """All observed numbers (F, D), whether the policy sees them or not; None if there are only images."""
    columns = dataset.hf_dataset.with_format("numpy")
    keys = [
        key
        for key, feature in dataset.meta.features.items()
        if key.startswith("observation") and feature["dtype"] not in ("image", "video")
    ]
    found = [np.stack(list(columns[key][:])).reshape(len(columns), -1) for key in keys]
    return np.concatenate(found, axis=1).astype(np.float64) if found else None


def _execute(subject: Subject) -> list[tuple[np.ndarray, np.ndarray]]:
    """What is commanded and what was done, (L, A) each, in every episode."""
    rows = _rows(subject.recording)
    spans = [rows[each] for each in subject.episodes]
    seen = observations(subject.dataset, spans, subject.policy.policy.config)
    commands = commands_at(subject.policy, seen, subject.episodes)
    done = {each.index: each.action for each in subject.recording.episodes}
    return [
        (ours[: len(done[each])].astype(np.float64), done[each])
        for ours, each in zip(commands, subject.episodes, strict=True)
    ]


def _grippers(
    floor: NoiseFloor,
    pairs: Sequence[tuple[np.ndarray, np.ndarray]],
    actions: np.ndarray,
    recording: Recording,
) -> list[Gripper]:
    """Dimensions that are grippers by name, or leap like them, and that switch."""
    found = []
    for dim in floor.moving:
        low, high = np.quantile(actions[:, dim], SPAN)
        name = recording.action_names[dim]
        if high > low and (is_hand(name) or floor.dimensions[dim].switches):
            own = [(ours[:, dim], theirs[:, dim]) for ours, theirs in pairs]
            found.append(time_gripper(name, own, (float(low), float(high)), recording.fps))
    return [each for each in found if each.demonstrated or each.extra]


def _draw(subject: Subject, steps: int) -> Drawn:
    """Chunks along the first replayed episode."""
    start, length = _rows(subject.recording)[subject.episodes[0]]
    every = max(1, steps // 2, length // MOST_DRAWN)
    at = np.arange(0, length, every)
    chunks = chunks_at(subject.policy, subject.dataset, start + at)
    done = next(each for each in subject.recording.episodes if each.index == subject.episodes[0])
    return Drawn(subject.episodes[0], done.action, at, chunks)
