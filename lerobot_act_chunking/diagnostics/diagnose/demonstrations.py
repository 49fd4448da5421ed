"""What demonstrations say of a policy: where they start, their statistics, and how well it knows them."""

from collections.abc import Mapping, Sequence
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
from lerobot_act_chunking.diagnostics.core.episodes import evenly
from lerobot_act_chunking.diagnostics.core.executable import predicting
from lerobot_act_chunking.diagnostics.core.training import read_training
from lerobot_act_chunking.errors import DatasetError, FeatureError
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
    """How far off the policy's chunks are where a demonstrator was.

    Attributes:
        error: mean absolute error [standard deviations of the action].
        mean_action: the same of always doing the mean action.
        first_action: the same of holding the first demonstrated action.
    """

    error: float
    mean_action: float
    first_action: float


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
    config = policy.policy.config
    chunk = _chunk(policy, demonstrations, episodes)
    predicted, demonstrated, counts = chunk
    stats = demonstrations.stats[ACTION]
    spread, mean = (np.ravel(stats[name]).astype(np.float64) for name in ("std", "mean"))
    moves = spread > max(1e-6, float(getattr(predicting(config), "norm_std_floor", 0.0) or 0.0))
    scale = np.where(moves, spread, np.inf)

    def off(actions: np.ndarray) -> float:
        return float(
            (np.abs(actions - demonstrated) / scale)[counts].mean() * len(moves) / max(1, moves.sum())
        )

    return Knowledge(off(predicted), off(np.broadcast_to(mean, demonstrated.shape)), off(demonstrated[:, :1]))


def _chunk(
    policy: LoadedPolicy, demonstrations: Demonstrations, episodes: Sequence[int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Predicted and demonstrated chunks (M, T, A), and which steps (M, T) lie within their episode."""
    config = predicting(policy.policy.config)
    dataset, fps = demonstrations.dataset, demonstrations.fps
    columns = dataset.hf_dataset.with_format("numpy")
    index = np.asarray(columns["episode_index"][:])
    rows = np.flatnonzero(np.isin(index, episodes))
    rows = rows[evenly(len(rows), OBSERVATIONS)]
    deltas = config.observation_delta_indices or [0]
    keys = [*config.input_features, "task"]
    times = (
        {key: [delta / fps for delta in deltas] for key in config.input_features} if len(deltas) > 1 else None
    )
    windows = LeRobotDataset(dataset.repo_id, root=dataset.root, delta_timestamps=times)
    batch = default_collate([{key: windows[int(row)][key] for key in keys} for row in rows])
    policy.reset()
    with torch.inference_mode():
        chunk = action_of(policy.policy.predict_action_chunk(policy.preprocessor(batch)))
        predicted = policy.postprocessor(chunk.flatten(0, 1)).cpu().numpy().reshape(chunk.shape)
    policy.reset()
    steps = rows[:, None] + np.arange(predicted.shape[1])
    inside = (steps < len(index)) & (index[np.minimum(steps, len(index) - 1)] == index[rows][:, None])
    actions = np.stack(list(columns[ACTION][:])).astype(np.float64)
    return predicted.astype(np.float64), actions[np.minimum(steps, len(index) - 1)], inside
