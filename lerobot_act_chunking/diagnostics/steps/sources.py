"""Observations that a policy is asked about, with what the demonstrator did there."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.utils.constants import ACTION
from torch.utils.data import default_collate

from act_chunking_runtime.number_checks import check_at_least
from lerobot_act_chunking.data.actions import episode_starts, is_dataset
from lerobot_act_chunking.data.dimension_names import dimension_names
from lerobot_act_chunking.data.quiet import quiet_missing_ffmpeg
from lerobot_act_chunking.diagnostics.core.compatibility import OTHER_DATASET, check_features, check_rate
from lerobot_act_chunking.diagnostics.core.episodes import evenly
from lerobot_act_chunking.diagnostics.core.measures import Measure, measure_of
from lerobot_act_chunking.diagnostics.core.training import Training, read_training
from lerobot_act_chunking.diagnostics.steps.measuring import Demonstrated
from lerobot_act_chunking.errors import DatasetError, FeatureError

SLOW = 0.25
"""Speed, as a share of a point's fast motion, below which the robot counts as close to contact."""
GRIPPER_MOVES = 0.01
"""Change of a gripper's command per control step, as a share of its range, that counts as a transition."""
AROUND_TRANSITION_S = 0.2


@dataclass(frozen=True)
class HeldOut:
    """Observations from the last episodes of a dataset.

    Attributes:
        dataset: its folder.
        fps: control steps per second.
        episodes: the episodes they come from.
        seen_in_training: whether the policy was trained on them, as far as its checkpoint tells.
        observations: raw batch, tensors (M, n_obs_steps, ...).
        demonstrated: the actions from each observation on.
        measure: what actions mean in space.
    """

    dataset: str
    fps: float
    episodes: list[int]
    seen_in_training: bool
    observations: dict[str, Any]
    demonstrated: Demonstrated
    measure: Measure


def hold_out(
    path: str | None, checkpoint: str, config: Any, *, n_steps: int, episodes: int, observations: int
) -> HeldOut:
    """Read observations, evenly spread over whole episodes at the end of a dataset.

    Args:
        path: a LeRobotDataset's folder; None for the one in the checkpoint's training configuration.
        checkpoint: the policy's folder or repo id.
        config: the policy's configuration, which says what it observes.
        n_steps: control steps of each chunk that are executed; observations with fewer left are not used.
        episodes: how many to take, from the last one backwards.
        observations: how many to take; fewer if there are not as many.

    Raises:
        DatasetError: no dataset, or one that is damaged or has too short episodes.
        ConfigurationError: numbers below 1.
        FeatureError: the dataset lacks what the policy observes, or is another robot's.
    """
    check_at_least(1, episodes=episodes, observations=observations)
    training = read_training(checkpoint, config)
    folder = Path(path or training.folder or "")
    if not is_dataset(folder):
        absent = f"there is no dataset at {path}" if path else "the checkpoint's training dataset is not here"
        raise DatasetError(f"{absent}: give a LeRobotDataset's folder (with meta/info.json) as --dataset")
    dataset = _open(folder, config, training.fps)
    actions = _column(dataset, ACTION).astype(np.float64)
    measure = measure_of(dataset.meta.features[ACTION])
    spans = _spans(_column(dataset, "episode_index"))
    chosen = list(spans)[-episodes:]
    near = np.zeros(len(actions), bool)
    for start, end in spans.values():
        grippers = actions[start:end, _grippers(dataset.meta.features[ACTION])]
        near[start:end] = near_contact(measure.points(actions[start:end]), grippers, dataset.meta.fps)
    starts = [np.arange(spans[each][0], spans[each][1] - n_steps + 1) for each in chosen]
    rows = np.concatenate(starts)
    rows = rows[evenly(len(rows), observations)]
    if not rows.size:
        raise DatasetError(f"no episode of {folder} is as long as the {n_steps} control steps of a chunk")
    windows = rows[:, None] + np.arange(n_steps)
    return HeldOut(
        dataset=str(folder),
        fps=float(dataset.meta.fps),
        episodes=chosen,
        seen_in_training=_seen(folder, chosen, training),
        observations=_collate(dataset, rows, config),
        demonstrated=Demonstrated(actions[windows], near[windows]),
        measure=measure,
    )


def near_contact(points: np.ndarray, grippers: np.ndarray, fps: float) -> np.ndarray:
    """Which steps (L,) of an episode are close to contact: every point moves slowly, or a gripper moves.

    Args:
        points: commanded positions (L, P, C).
        grippers: commands (L, G).
        fps: control steps per second.
    """
    speeds = np.linalg.norm(np.gradient(points, axis=0), axis=-1)
    fast = np.percentile(speeds, 95, axis=0)
    slow = (speeds <= SLOW * fast).all(1)
    span = np.ptp(grippers, axis=0)
    changes = np.abs(np.diff(grippers, axis=0, prepend=grippers[:1]))
    moving = (changes > GRIPPER_MOVES * span).any(1).astype(float)
    around = 2 * round(AROUND_TRANSITION_S * fps) + 1
    return slow | (np.convolve(moving, np.ones(around), "full")[around // 2 :][: len(moving)] > 0)


def _open(folder: Path, config: Any, trained_fps: float | None) -> LeRobotDataset:
    quiet_missing_ffmpeg()
    wanted = list(config.input_features)
    deltas = config.observation_delta_indices or [0]
    try:
        plain = LeRobotDataset(f"local/{folder.name}", root=folder)
        shapes = {key: feature["shape"] for key, feature in plain.meta.features.items()}
        check_features(config, shapes, f"the dataset at {folder}", OTHER_DATASET)
        check_rate(trained_fps, plain.meta.fps, f"the dataset at {folder}", OTHER_DATASET)
        times = {key: [delta / plain.meta.fps for delta in deltas] for key in wanted}
        return LeRobotDataset(f"local/{folder.name}", root=folder, delta_timestamps=times)
    except FeatureError:
        raise
    except Exception as error:  # whatever LeRobot and its parsers raise on damaged files
        raise DatasetError(f"the dataset at {folder} cannot be read: {error}") from error


def _column(dataset: LeRobotDataset, name: str) -> np.ndarray:
    return np.asarray(dataset.hf_dataset.select_columns([name]).with_format("numpy")[:][name])


def _spans(episode_index: np.ndarray) -> dict[int, tuple[int, int]]:
    """First and behind-the-last row of each episode, in their order."""
    starts = episode_starts(episode_index)
    ends = [*starts[1:], len(episode_index)]
    return {
        int(episode_index[start]): (int(start), int(end)) for start, end in zip(starts, ends, strict=True)
    }


def _grippers(action: dict[str, Any]) -> list[int]:
    return [dim for dim, name in enumerate(dimension_names(action)) if "gripper" in name]


def _collate(dataset: LeRobotDataset, rows: np.ndarray, config: Any) -> dict[str, Any]:
    kept = (*config.input_features, "task")
    items: list[Any] = [dataset[int(row)] for row in rows]
    return default_collate([{key: item[key] for key in kept} for item in items])


def _seen(folder: Path, episodes: list[int], training: Training) -> bool:
    if training.folder is None or folder.resolve() != Path(training.folder).resolve():
        return False
    return training.episodes is None or bool(set(episodes) & set(training.episodes))
