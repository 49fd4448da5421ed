"""Candidates on recorded observations: what the policy would command where a demonstrator was."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from torch.utils.data import default_collate

from lerobot_act_chunking.compat import action_of
from lerobot_act_chunking.data.quiet import quiet_missing_ffmpeg
from lerobot_act_chunking.diagnostics.core.compatibility import OTHER_DATASET, check_features, check_rate
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes, read_episodes
from lerobot_act_chunking.diagnostics.core.executable import execute
from lerobot_act_chunking.diagnostics.core.rollouts import reset_episodes
from lerobot_act_chunking.diagnostics.core.training import read_training
from lerobot_act_chunking.diagnostics.tune.candidates import Candidate
from lerobot_act_chunking.errors import DatasetError, FeatureError
from lerobot_act_chunking.execution.executor import ChunkExecutor
from lerobot_act_chunking.execution.settings import ExecutionSettings
from lerobot_act_chunking.policies.loading import LoadedPolicy


@dataclass(frozen=True)
class Replay:
    """One candidate on the demonstrator's observations.

    Attributes:
        distance: from the demonstrated actions, over all dimensions and steps [standard deviations].
        jump: change of the command where a chunk begins, beyond the demonstrated change [the same]; None
            where no second chunk begins.
        reaction_s: mean age of the observations behind a command [s]; None where weights depend on chunks.
    """

    distance: float
    jump: float | None
    reaction_s: float | None


@dataclass(frozen=True)
class HeldOut:
    """The last episodes of a dataset.

    Attributes:
        demonstrated: their actions.
        spread: standard deviation (A,) of the dataset's actions; infinite for those that never change.
        seen_in_training: whether the policy was trained on them, as far as its checkpoint tells.
        observations: raw batches, one per step: the episodes side by side, where those that have ended stay
            with their last observation.
    """

    demonstrated: ActionEpisodes
    spread: np.ndarray
    seen_in_training: bool
    observations: Callable[[], Iterator[dict[str, Any]]]


def hold_out(folder: str, checkpoint: str, config: Any, episodes: int) -> HeldOut:
    """The last ``episodes`` of a dataset.

    Raises:
        DatasetError: no dataset, or a damaged one.
        FeatureError: it lacks what the policy observes, or is another robot's.
    """
    recorded = read_episodes(folder)
    dataset = _open(folder, config, read_training(checkpoint, config).fps)
    chosen = list(recorded.episodes)[-episodes:]
    spread = np.concatenate(list(recorded.episodes.values())).std(0)
    ends = np.cumsum([len(each) for each in recorded.episodes.values()])
    lengths = {each: len(actions) for each, actions in recorded.episodes.items()}
    starts = dict(zip(lengths, (ends - list(lengths.values())).tolist(), strict=True))
    rows = [(starts[each], lengths[each]) for each in chosen]
    return HeldOut(
        demonstrated=recorded.only(chosen),
        spread=np.where(spread > 0, spread, np.inf),
        seen_in_training=_seen(folder, checkpoint, config, chosen),
        observations=_reader(dataset, rows, config),
    )


def replay(policy: LoadedPolicy, candidate: Candidate, held_out: HeldOut) -> Replay:
    """Execute a candidate's chunks at the observations of held-out episodes."""
    execute(policy, candidate.values)
    demonstrated = held_out.demonstrated
    reset_episodes(policy.policy, list(demonstrated.episodes))
    commands = []
    for observation in held_out.observations():
        with torch.inference_mode():
            action = action_of(policy.policy.select_action(policy.preprocessor(observation)))
            commands.append(policy.postprocessor(action).to("cpu").numpy())
    rows = np.stack(commands, axis=1)  # (E, longest, A)
    pairs = zip(rows, demonstrated.episodes.values(), strict=True)
    off = [(row[: len(own)] - own) / held_out.spread for row, own in pairs]
    starts = _first_steps(candidate.settings, rows.shape[1])
    jumps = [_size(np.diff(each, axis=0)[starts[starts < len(each)] - 1]) for each in off]
    n_jumps = sum(map(len, jumps))
    return Replay(
        distance=float(np.concatenate([_size(each) for each in off]).mean()),
        jump=float(np.concatenate(jumps).mean()) if n_jumps else None,
        reaction_s=reaction_s(candidate.settings, demonstrated.fps),
    )


def _size(off: np.ndarray) -> np.ndarray:
    """Root mean square over the dimensions, (steps,)."""
    return np.sqrt((off**2).mean(1))


def _first_steps(settings: ExecutionSettings, length: int) -> np.ndarray:
    """Steps at which a chunk other than the first is first used."""
    return np.arange(settings.replan_interval + settings.latency_steps, length, settings.replan_interval)


def reaction_s(settings: ExecutionSettings, fps: float) -> float | None:
    """Mean age of the observations behind a command, once chunks overlap [s].

    The executor itself tells: of chunks that hold the step of their observation it makes its weighted mean.
    """
    if settings.execution in ("adaptive", "coherence"):
        return None
    executor = ChunkExecutor(settings)
    settled = settings.chunk_size + settings.latency_steps
    steps = settled + 2 * settings.chunk_size
    ages = []
    for step in range(steps):
        seen = torch.full((1, settings.n_action_steps, 1), float(step))
        ages.append(step - executor.step(lambda _, seen=seen: seen, 1).item())
    return float(np.mean(ages[settled:])) / fps


def _open(folder: str, config: Any, trained_fps: float | None) -> LeRobotDataset:
    quiet_missing_ffmpeg()
    name = f"local/{Path(folder).name}"
    try:
        dataset = LeRobotDataset(name, root=folder)
        shapes = {key: feature["shape"] for key, feature in dataset.meta.features.items()}
        check_features(config, shapes, f"the dataset at {folder}", OTHER_DATASET)
        check_rate(trained_fps, dataset.meta.fps, f"the dataset at {folder}", OTHER_DATASET)
    except FeatureError:
        raise
    except Exception as error:  # whatever LeRobot and its parsers raise on damaged files
        raise DatasetError(f"the dataset at {folder} cannot be read: {error}") from error
    return dataset


def _reader(
    dataset: LeRobotDataset, rows: Sequence[tuple[int, int]], config: Any
) -> Callable[[], Iterator[dict[str, Any]]]:
    """Reads the observations; images anew each time, because they do not fit into memory."""

    def read() -> Iterator[dict[str, Any]]:
        return _side_by_side(dataset, rows, (*config.input_features, "task"))

    if config.image_features:
        return read
    kept = list(read())
    return lambda: iter(kept)


def _side_by_side(
    dataset: LeRobotDataset, rows: Sequence[tuple[int, int]], keys: Sequence[str]
) -> Iterator[dict[str, Any]]:
    """Batches of the episodes that begin at these rows and are so long."""
    for step in range(max(length for _, length in rows)):
        items: list[Any] = [dataset[start + min(step, length - 1)] for start, length in rows]
        yield default_collate([{key: item[key] for key in keys} for item in items])


def _seen(folder: str, checkpoint: str, config: Any, episodes: Sequence[int]) -> bool:
    training = read_training(checkpoint, config)
    if training.folder is None or Path(folder).resolve() != Path(training.folder).resolve():
        return False
    return training.episodes is None or bool({*episodes} & {*training.episodes})
