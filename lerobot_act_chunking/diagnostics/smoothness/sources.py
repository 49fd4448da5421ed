"""Where episodes come from: a checkpoint that is run in a simulation, or a dataset on disk."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.utils.constants import ACTION, OBS_STATE

from act_chunking_runtime.number_checks import check_at_least
from lerobot_act_chunking.data.actions import episode_starts
from lerobot_act_chunking.data.dimension_names import dimension_names
from lerobot_act_chunking.data.quiet import quiet_missing_ffmpeg
from lerobot_act_chunking.diagnostics.core.environments import action_names, environment_of
from lerobot_act_chunking.diagnostics.core.noise_floor import NoiseFloor, measure_noise
from lerobot_act_chunking.diagnostics.core.rollouts import Inference, Rollout, roll_out
from lerobot_act_chunking.diagnostics.core.success_keys import never_said
from lerobot_act_chunking.diagnostics.core.training import untrained
from lerobot_act_chunking.diagnostics.smoothness.settings import EvaluationSpec
from lerobot_act_chunking.envs.aloha.tasks import JOINT_NAMES
from lerobot_act_chunking.errors import DatasetError, FeatureError
from lerobot_act_chunking.policies.loading import LoadedPolicy, check_complete, load_policy, read_config

EVALUATED = "agent_pos"
POSITIONS = (OBS_STATE, EVALUATED)
"""Columns with joint positions: LeRobot's, and the one that ``lerobot-eval --eval.recording=true`` writes."""
SUCCESS = "next.success"
Progress = Callable[[int], None]


@dataclass(frozen=True)
class Source:
    """Episodes and what is needed to measure them.

    Attributes:
        rollouts: the episodes.
        joint_names: of the A dimensions of an action.
        action_std: (A,) of the training data.
        latency_steps: control steps after an inference at which its chunk is first used.
        knows_success: whether the rollouts' ``success`` means anything.
        notes: what to know about them, in sentences.
        floor: of demonstrations: which dimensions move; None for a policy's motion.
    """

    rollouts: list[Rollout]
    joint_names: Sequence[str]
    action_std: np.ndarray
    latency_steps: int = 0
    knows_success: bool = True
    notes: tuple[str, ...] = ()
    floor: NoiseFloor | None = None


def holds_datasets(path: str) -> bool:
    """Whether a path is a folder with datasets in it, and no checkpoint.

    Raises:
        DatasetError: a folder with neither.
    """
    folder = Path(path)
    if not folder.is_dir() or (folder / "config.json").exists():
        return False
    if not _dataset_folders(folder):
        raise DatasetError(
            f"{path} holds neither a checkpoint (config.json, as in …/checkpoints/last/pretrained_model) "
            "nor a dataset (meta/info.json)"
        )
    return True


def run_checkpoint(path: str, spec: EvaluationSpec, progress: Progress | None = None) -> Source:
    """Evaluate a checkpoint, as ``lerobot-eval`` would.

    Args:
        path: checkpoint folder or repo id.
        spec: which episodes.
        progress: called with the number of finished episodes.

    Raises:
        ConfigurationError: no such checkpoint, or an environment that cannot be made for it.
        FeatureError: a policy for another robot or control rate.
    """
    config = read_config(path)
    check_complete(path, config.type)
    env_config = environment_of(config, spec.environment, path)
    policy = load_policy(path)
    seeds = range(spec.seed, spec.seed + spec.episodes)
    rollouts = roll_out(policy, env_config, seeds, n_envs=spec.n_envs, progress=progress)
    std = action_std(policy)
    unknown = never_said(env_config, [rollout.instead for rollout in rollouts])
    return Source(
        rollouts=rollouts,
        joint_names=action_names(env_config, rollouts[0].commands.shape[1], path),
        action_std=_std_of(rollouts) if std is None else std,
        latency_steps=getattr(policy.policy.config, "latency_steps", 0),
        knows_success=unknown is None,
        notes=tuple(filter(None, [untrained(path), unknown])),
    )


def action_std(policy: LoadedPolicy) -> np.ndarray | None:
    """Standard deviation ``(A,)`` of a policy's training actions; None if it does not normalise them."""
    for step in policy.postprocessor.steps:
        std = (getattr(step, "stats", None) or {}).get(ACTION, {}).get("std")
        if std is not None:
            return np.asarray(std, float)
    return None


def read_dataset(path: str, replan_interval: int | None = None) -> Source:
    """Read demonstrations, or what ``lerobot-eval --eval.recording=true`` wrote.

    Args:
        path: a LeRobotDataset's folder, or one that holds several (one per environment).
        replan_interval: control steps between the chunks that made the motion; None if it was not chunked.

    Raises:
        DatasetError: no dataset, or one without actions.
        FeatureError: the datasets in the folder are of different robots.
        ConfigurationError: a replan interval below 1.
    """
    check_at_least(1, replan_interval=replan_interval)
    datasets = [_open(folder) for folder in _dataset_folders(Path(path))]
    if not datasets:
        raise DatasetError(f"there is no dataset at {path}: no meta/info.json in it or below")
    _check_same_robot(path, datasets)
    rollouts = [rollout for dataset in datasets for rollout in _episodes(dataset, replan_interval)]
    first = datasets[0].meta
    std = first.stats[ACTION]["std"] if first.stats and len(datasets) == 1 else _std_of(rollouts)
    names = _joint_names(first.features)
    return Source(
        rollouts=rollouts,
        joint_names=names,
        action_std=np.asarray(std, float),
        knows_success=SUCCESS in first.features,
        notes=tuple(filter(None, [_no_positions(first.features)])),
        floor=measure_noise([rollout.commands for rollout in rollouts], first.fps, names),
    )


def _dataset_folders(path: Path) -> list[Path]:
    return sorted(info.parent.parent for info in path.glob("**/meta/info.json"))


def _open(folder: Path) -> LeRobotDataset:
    quiet_missing_ffmpeg()
    try:
        dataset = LeRobotDataset(f"local/{folder.name}", root=folder)
    except Exception as error:  # whatever LeRobot and its parsers raise on damaged files
        raise DatasetError(f"the dataset at {folder} cannot be read: {error}") from error
    if ACTION not in dataset.meta.features:
        raise DatasetError(
            f"the dataset at {folder} has no {ACTION!r}; it has {', '.join(dataset.meta.features)}"
        )
    return dataset


def _check_same_robot(path: str, datasets: Sequence[LeRobotDataset]) -> None:
    """Refuse datasets of one source that differ in the action's size or in the control rate."""
    robots = [(dataset.meta.features[ACTION]["shape"][0], dataset.meta.fps) for dataset in datasets]
    if len(set(robots)) > 1:
        named = zip(datasets, robots, strict=True)
        found = [f"{each.root.name} {dims} at {fps:g} Hz" for each, (dims, fps) in named]
        raise FeatureError(
            f"the datasets in {path} are of different robots, by the dimensions of their actions and their "
            f"control rates: {', '.join(found)}; give a folder with those of one robot"
        )


def _episodes(dataset: LeRobotDataset, replan_interval: int | None) -> list[Rollout]:
    features = dataset.meta.features
    position = _position_key(features)
    wanted = ["episode_index", ACTION, *filter(None, [position, SUCCESS if SUCCESS in features else None])]
    table = dataset.hf_dataset.select_columns(wanted).with_format("numpy")[:]
    commands = np.asarray(table[ACTION], float)
    positions = np.asarray(table[position], float) if position else np.empty((len(commands), 0))
    success = np.asarray(table[SUCCESS], bool).ravel() if SUCCESS in table else np.zeros(len(commands), bool)
    starts = episode_starts(np.asarray(table["episode_index"]))
    ends = [*starts[1:], len(commands)]
    return [
        Rollout(
            seed=int(table["episode_index"][start]),
            dt=1 / dataset.meta.fps,
            commands=commands[start:end],
            positions=positions[start:end],
            rewards=np.zeros(end - start),
            success=bool(success[start:end].any()),
            inferences=_assumed_inferences(end - start, replan_interval, commands.shape[1]),
        )
        for start, end in zip(starts, ends, strict=True)
    ]


def _position_key(features: dict[str, dict[str, Any]]) -> str | None:
    width = tuple(features[ACTION]["shape"])
    return next(
        (key for key in POSITIONS if key in features and tuple(features[key]["shape"]) == width), None
    )


def _no_positions(features: dict[str, dict[str, Any]]) -> str | None:
    """Why there is no achieved motion."""
    if _position_key(features) is not None:
        return None
    width = features[ACTION]["shape"][0]
    found = [f"{key} has {features[key]['shape'][0]}" for key in POSITIONS if key in features]
    there = ", and ".join(found) if found else f"there is no {OBS_STATE}"
    return (
        f"the action has {width} numbers, but {there}: which of them belong together is not known, so that "
        "neither the achieved motion nor its lag is measured"
    )


def _assumed_inferences(steps: int, replan_interval: int | None, width: int) -> tuple[Inference, ...]:
    if replan_interval is None:
        return ()
    return tuple(Inference(step, np.empty((0, width))) for step in range(0, steps, replan_interval))


def _joint_names(features: dict[str, dict[str, Any]]) -> list[str]:
    """The dataset's own names; ALOHA's for what lerobot-eval records of it without any."""
    action = features[ACTION]
    if EVALUATED in features and not action.get("names") and tuple(action["shape"]) == (len(JOINT_NAMES),):
        return list(JOINT_NAMES)
    return list(dimension_names(action))


def _std_of(rollouts: list[Rollout]) -> np.ndarray:
    return np.concatenate([rollout.commands for rollout in rollouts]).std(0)
