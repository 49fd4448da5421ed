"""What demonstrations say of a policy: where they start, their statistics, and how well it knows them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.utils.constants import ACTION

from lerobot_act_chunking.data.actions import episode_starts, is_dataset
from lerobot_act_chunking.diagnostics.core.episodes import evenly
from lerobot_act_chunking.diagnostics.core.executable import predicting
from lerobot_act_chunking.diagnostics.core.recorded import chunks_at, nearest_rows, open_recorded
from lerobot_act_chunking.diagnostics.core.training import read_training
from lerobot_act_chunking.policies.loading import LoadedPolicy

OBSERVATIONS = 64
"""At which the policy is asked, spread over the episodes."""


@dataclass(frozen=True)
class Demonstrations:
    """A dataset as far as it explains a policy.

    Attributes:
        folder: where it lies.
        stats: the dataset's own, by key.
        starts: the first observation of each episode, (E, D), by key; vectors alone.
        seen: episodes that the policy learned from.
        unseen: the others.
        fps: control steps per second.
        dataset: to read more from.
    """

    folder: str
    stats: Mapping[str, Any]
    starts: Mapping[str, np.ndarray]
    seen: list[int]
    unseen: list[int]
    fps: float
    dataset: LeRobotDataset


@dataclass(frozen=True)
class Knowledge:
    """How the policy's chunks are where a demonstrator was, in standard deviations of the action.

    Attributes:
        error: mean absolute distance from what the demonstrator did.
        soon: the same of the first tenth of the chunks, which the observation says most of.
        mean_action: the same of always doing the mean action.
        scatter: of two chunks that are drawn at the same observation, from each other; 0 without noise.
        disagreement: of a chunk and the next one, at the steps that both cover; None if they never overlap.
        nearest: distance ``soon`` of who does what was done at the nearest observation of another
            demonstration; None without vectors to tell which that is, or another demonstration.
    """

    error: float
    soon: float
    mean_action: float
    scatter: float
    disagreement: float | None
    nearest: float | None = None


def find_demonstrations(given: str | None, checkpoint: str, config: Any) -> Demonstrations | None:
    """The dataset that is given, or that of the checkpoint's training if it is here; else None.

    Raises:
        DatasetError: what is given is no dataset, or a damaged one.
        FeatureError: the given one lacks what the policy observes, or is another robot's.
    """
    training = read_training(checkpoint, config)
    folder = given or training.folder
    if folder is None or (given is None and not is_dataset(folder)):
        return None
    dataset = open_recorded(folder, config)
    columns = dataset.hf_dataset.with_format("numpy")
    index = np.asarray(columns["episode_index"][:])
    first = episode_starts(index)
    episodes = [int(each) for each in index[first]]
    own = training.folder is not None and Path(folder).resolve() == Path(training.folder).resolve()
    learned = (episodes if training.episodes is None else training.episodes) if own else []
    vectors = [key for key in config.input_features if key not in config.image_features]
    starts = columns.select(first[np.isin(episodes, learned or episodes)].tolist())
    return Demonstrations(
        folder=str(folder),
        stats=dataset.meta.stats or {},
        starts={key: np.stack(list(starts[key][:])).astype(np.float64) for key in vectors},
        seen=[each for each in episodes if each in learned],
        unseen=[each for each in episodes if each not in learned],
        fps=float(dataset.meta.fps),
        dataset=dataset,
    )


def ask(policy: LoadedPolicy, demonstrations: Demonstrations, episodes: Sequence[int]) -> Knowledge | None:
    """How well a policy knows some episodes; None of none.

    Args:
        policy: in evaluation mode; it is reset.
        demonstrations: the dataset.
        episodes: of it.
    """
    if not episodes:
        return None
    columns = demonstrations.dataset.hf_dataset.with_format("numpy")
    index = np.asarray(columns["episode_index"][:])
    rows = np.flatnonzero(np.isin(index, episodes))
    rows = rows[evenly(len(rows), OBSERVATIONS)]
    first = chunks_at(policy, demonstrations.dataset, rows)
    again = chunks_at(policy, demonstrations.dataset, rows, draw=1)
    steps = rows[:, None] + np.arange(first.shape[1])
    last = len(index) - 1
    inside = (steps <= last) & (index[np.minimum(steps, last)] == index[rows][:, None])
    actions = np.stack(list(columns[ACTION][:])).astype(np.float64)[np.minimum(steps, last)]
    stats = demonstrations.stats[ACTION]
    spread, mean = (np.ravel(stats[name]).astype(np.float64) for name in ("std", "mean"))
    floor = float(getattr(predicting(policy.policy.config), "norm_std_floor", 0.0) or 0.0)
    moving = spread > max(floor, 1e-6)

    def size(differences: np.ndarray) -> float:
        return float((np.abs(differences[..., moving]) / spread[moving]).mean())

    early = max(1, first.shape[1] // 10)
    every = policy.policy.config.execution_settings.replan_interval
    follows = inside[:, min(every, inside.shape[1] - 1)]
    overlaps = every < first.shape[1] and follows.any()
    return Knowledge(
        error=size((first - actions)[inside]),
        soon=size((first - actions)[:, :early][inside[:, :early]]),
        mean_action=size((mean - actions)[inside]),
        scatter=size((first - again)[inside]),
        disagreement=size(
            first[follows, every:]
            - chunks_at(policy, demonstrations.dataset, rows[follows] + every)[:, : first.shape[1] - every]
        )
        if overlaps
        else None,
        nearest=_copied(demonstrations, policy.policy.config, rows, size, early),
    )


def _copied(
    demonstrations: Demonstrations,
    config: Any,
    rows: np.ndarray,
    size: Callable[[np.ndarray], float],
    n_steps: int,
) -> float | None:
    """How far off the first ``n_steps`` actions are at the nearest observation of another demonstration."""
    columns = demonstrations.dataset.hf_dataset.with_format("numpy")
    index = np.asarray(columns["episode_index"][:])
    keys = [key for key in config.input_features if key in demonstrations.starts]
    if not keys or index[0] == index[-1]:
        return None
    seen = np.concatenate([np.stack(list(columns[key][:])).reshape(len(index), -1) for key in keys], axis=1)
    actions = np.stack(list(columns[ACTION][:])).astype(np.float64)
    differences = []
    for row, nearest in zip(rows, nearest_rows(seen, index, rows), strict=True):
        steps = range(min(n_steps, _left(index, row), _left(index, nearest)))
        differences += [actions[nearest + step] - actions[row + step] for step in steps]
    return size(np.stack(differences))


def _left(index: np.ndarray, row: int) -> int:
    """Rows of an episode from this one on."""
    return int(np.searchsorted(index, index[row], side="right")) - int(row)
