"""A policy on recorded observations: the chunks that it predicts there, and the commands that it executes."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int64
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from torch.utils.data import default_collate

from lerobot_act_chunking.compat import action_of
from lerobot_act_chunking.data.quiet import quiet_missing_ffmpeg
from lerobot_act_chunking.diagnostics.core.compatibility import OTHER_DATASET, check_features, check_rate
from lerobot_act_chunking.diagnostics.core.drawing import drawing
from lerobot_act_chunking.diagnostics.core.executable import predicting
from lerobot_act_chunking.diagnostics.core.rollouts import reset_episodes
from lerobot_act_chunking.diagnostics.core.training import read_training
from lerobot_act_chunking.errors import DatasetError, FeatureError
from lerobot_act_chunking.policies.loading import LoadedPolicy

HARDLY_VARIES = 1e-2  # spread of an observation, in its own units, that tells no two of them apart
TOGETHER = 64  # observations that are in memory, and predicted from, at once
Observations = Callable[[], Iterator[dict[str, Any]]]
"""Raw batches, one per control step: episodes side by side."""


def open_recorded(folder: str, config: Any, trained_fps: float | None = None) -> LeRobotDataset:
    """A dataset that a policy fits.

    Args:
        folder: where it lies.
        config: the policy's.
        trained_fps: control steps per second of the policy's training, if they are to be the dataset's.

    Raises:
        DatasetError: no dataset, or a damaged one.
        FeatureError: it lacks what the policy observes, is another robot's, or of another rate.
    """
    quiet_missing_ffmpeg()
    try:
        dataset = LeRobotDataset(f"local/{Path(folder).name}", root=folder)
        shapes = {key: feature["shape"] for key, feature in dataset.meta.features.items()}
        check_features(config, shapes, f"the dataset at {folder}", OTHER_DATASET)
        check_rate(trained_fps, dataset.meta.fps, f"the dataset at {folder}", OTHER_DATASET)
    except FeatureError:
        raise
    except Exception as error:  # whatever LeRobot and its parsers raise on damaged files
        raise DatasetError(f"the dataset at {folder} cannot be read: {error}") from error
    return dataset


def learned_episodes(folder: str, checkpoint: str, config: Any, episodes: Sequence[int]) -> list[int]:
    """Which of a dataset's episodes a policy was trained on, as far as its checkpoint tells."""
    training = read_training(checkpoint, config)
    if training.folder is None or Path(folder).resolve() != Path(training.folder).resolve():
        return []
    return [each for each in episodes if training.episodes is None or each in training.episodes]


def observations(dataset: LeRobotDataset, rows: Sequence[tuple[int, int]], config: Any) -> Observations:
    """The observations of episodes, to be read as often as one likes; images are decoded anew each time.

    Episodes that have ended stay with their last observation.

    Args:
        dataset: to read from.
        rows: first row and length of each episode.
        config: the policy's, which says what it observes.
    """

    def read() -> Iterator[dict[str, Any]]:
        return _side_by_side(dataset, rows, (*config.input_features, "task"))

    if config.image_features:  # they do not fit into memory
        return read
    kept = list(read())
    return lambda: iter(kept)


def commands_at(
    policy: LoadedPolicy, seen: Observations, episodes: Sequence[int]
) -> Float[np.ndarray, "E T A"]:
    """What a policy commands in raw units where a demonstrator was, as its configuration executes chunks.

    Args:
        policy: in evaluation mode; it is reset.
        seen: observations of E episodes.
        episodes: their numbers, which seed what the policy draws.
    """
    reset_episodes(policy.policy, list(episodes))
    commands = []
    for observation in seen():
        with torch.inference_mode():
            action = action_of(policy.policy.select_action(policy.preprocessor(observation)))
            commands.append(policy.postprocessor(action).to("cpu").numpy())
    return np.stack(commands, axis=1)


def chunks_at(
    policy: LoadedPolicy, dataset: LeRobotDataset, rows: Int64[np.ndarray, " M"], draw: int = 0
) -> Float[np.ndarray, "M T A"]:
    """What a policy would do at these rows of a dataset, in raw units.

    Args:
        policy: in evaluation mode; it is reset.
        dataset: which has what the policy observes.
        rows: of the dataset.
        draw: which repetition of the policy's noise.
    """
    config = predicting(policy.policy.config)
    deltas = config.observation_delta_indices or [0]
    keys = [*config.input_features, "task"]
    several = {key: [delta / dataset.meta.fps for delta in deltas] for key in config.input_features}
    windows = LeRobotDataset(
        dataset.repo_id, root=dataset.root, delta_timestamps=several if len(deltas) > 1 else None
    )
    raw = []
    with drawing(policy.policy, draw, 0), torch.inference_mode():
        for first in range(0, len(rows), TOGETHER):
            items: list[Any] = [windows[int(row)] for row in rows[first : first + TOGETHER]]
            batch = default_collate([{key: item[key] for key in keys} for item in items])
            policy.reset()
            chunk = action_of(policy.policy.predict_action_chunk(policy.preprocessor(batch)))
            raw.append(policy.postprocessor(chunk.flatten(0, 1)).cpu().numpy().reshape(chunk.shape))
    policy.reset()
    return np.concatenate(raw).astype(np.float64)


def nearest_rows(
    seen: Float[np.ndarray, "F D"], episode: Int64[np.ndarray, " F"], rows: Int64[np.ndarray, " M"]
) -> Int64[np.ndarray, " M"]:
    """The row of another episode whose observation is nearest, each number in its standard deviations.

    Args:
        seen: observations of all frames.
        episode: of each frame; at least two different ones.
        rows: in question.
    """
    seen = (seen - seen.mean(0)) / np.maximum(seen.std(0), HARDLY_VARIES)
    distances = (
        np.where(episode == episode[row], np.inf, np.square(seen - seen[row]).sum(1)) for row in rows
    )
    return np.array([distance.argmin() for distance in distances], dtype=np.int64)


def _side_by_side(
    dataset: LeRobotDataset, rows: Sequence[tuple[int, int]], keys: Sequence[str]
) -> Iterator[dict[str, Any]]:
    """Batches of the episodes that begin at these rows and are so long."""
    for step in range(max(length for _, length in rows)):
        items: list[Any] = [dataset[start + min(step, length - 1)] for start, length in rows]
        yield default_collate([{key: item[key] for key in keys} for item in items])
