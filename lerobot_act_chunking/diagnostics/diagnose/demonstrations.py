"""What demonstrations say of a policy: where they start, their statistics, and how well it knows them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.utils.constants import ACTION
from torch.utils.data import default_collate

from lerobot_act_chunking.compat import action_of
from lerobot_act_chunking.data.actions import episode_starts, is_dataset
from lerobot_act_chunking.data.quiet import quiet_missing_ffmpeg
from lerobot_act_chunking.diagnostics.core.compatibility import OTHER_DATASET, check_features
from lerobot_act_chunking.diagnostics.core.drawing import drawing
from lerobot_act_chunking.diagnostics.core.episodes import evenly
from lerobot_act_chunking.diagnostics.core.executable import predicting
from lerobot_act_chunking.diagnostics.core.training import read_training
from lerobot_act_chunking.errors import DatasetError, FeatureError
from lerobot_act_chunking.policies.loading import LoadedPolicy

HARDLY_VARIES = 1e-2  # spread of an observation, in its own units, that tells no two of them apart
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
    dataset = _open(folder, config)
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


def _open(folder: str, config: Any) -> LeRobotDataset:
    quiet_missing_ffmpeg()
    try:
        dataset = LeRobotDataset(f"local/{Path(folder).name}", root=folder)
        shapes = {key: feature["shape"] for key, feature in dataset.meta.features.items()}
        check_features(config, shapes, f"the dataset at {folder}", OTHER_DATASET)
    except FeatureError:
        raise
    except Exception as error:  # whatever LeRobot and its parsers raise on damaged files
        raise DatasetError(f"the dataset at {folder} cannot be read: {error}") from error
    return dataset


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
    first = _chunks(policy, demonstrations, rows)
    again = _chunks(policy, demonstrations, rows, draw=1)
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
            - _chunks(policy, demonstrations, rows[follows] + every)[:, : first.shape[1] - every]
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
    seen = (seen - seen.mean(0)) / np.maximum(seen.std(0), HARDLY_VARIES)
    actions = np.stack(list(columns[ACTION][:])).astype(np.float64)
    differences = []
    for row in rows:
        distance = np.square(seen - seen[row]).sum(1)
        nearest = int(np.where(index == index[row], np.inf, distance).argmin())
        steps = range(min(n_steps, _left(index, row), _left(index, nearest)))
        differences += [actions[nearest + step] - actions[row + step] for step in steps]
    return size(np.stack(differences))


def _left(index: np.ndarray, row: int) -> int:
    """Rows of an episode from this one on."""
    return int(np.searchsorted(index, index[row], side="right")) - int(row)


def _chunks(
    policy: LoadedPolicy, demonstrations: Demonstrations, rows: np.ndarray, draw: int = 0
) -> np.ndarray:
    """What the policy would do at these rows, (M, T, A) in raw units."""
    config = predicting(policy.policy.config)
    dataset, deltas = demonstrations.dataset, config.observation_delta_indices or [0]
    keys = [*config.input_features, "task"]
    several = {key: [delta / demonstrations.fps for delta in deltas] for key in config.input_features}
    windows = LeRobotDataset(
        dataset.repo_id, root=dataset.root, delta_timestamps=several if len(deltas) > 1 else None
    )
    items: list[Any] = [windows[int(row)] for row in rows]
    batch = default_collate([{key: item[key] for key in keys} for item in items])
    with drawing(policy.policy, draw, 0), torch.inference_mode():
        policy.reset()
        chunk = action_of(policy.policy.predict_action_chunk(policy.preprocessor(batch)))
        raw = policy.postprocessor(chunk.flatten(0, 1)).cpu().numpy().reshape(chunk.shape)
    policy.reset()
    return raw.astype(np.float64)
