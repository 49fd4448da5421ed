"""Candidates on recorded observations: what the policy would command where a demonstrator was."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes, read_episodes
from lerobot_act_chunking.diagnostics.core.executable import execute
from lerobot_act_chunking.diagnostics.core.recorded import (
    Observations,
    commands_at,
    learned_episodes,
    observations,
    open_recorded,
)
from lerobot_act_chunking.diagnostics.core.training import read_training
from lerobot_act_chunking.diagnostics.tune.candidates import Candidate
from lerobot_act_chunking.execution.executor import ChunkExecutor
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
        observations: of these episodes, side by side.
    """

    demonstrated: ActionEpisodes
    spread: np.ndarray
    seen_in_training: bool
    observations: Observations


def hold_out(folder: str, checkpoint: str, config: Any, episodes: int) -> HeldOut:
    """The last ``episodes`` of a dataset.

    Raises:
        DatasetError: no dataset, or a damaged one.
        FeatureError: it lacks what the policy observes, or is another robot's.
    """
    recorded = read_episodes(folder)
    dataset = open_recorded(folder, config, read_training(checkpoint, config).fps)
    chosen = list(recorded.episodes)[-episodes:]
    spread = np.concatenate(list(recorded.episodes.values())).std(0)
    ends = np.cumsum([len(each) for each in recorded.episodes.values()])
    lengths = {each: len(actions) for each, actions in recorded.episodes.items()}
    starts = dict(zip(lengths, (ends - list(lengths.values())).tolist(), strict=True))
    rows = [(starts[each], lengths[each]) for each in chosen]
    return HeldOut(
        demonstrated=recorded.only(chosen),
        spread=np.where(spread > 0, spread, np.inf),
        seen_in_training=bool(learned_episodes(folder, checkpoint, config, chosen)),
        observations=observations(dataset, rows, config),
    )


def replay(policy: LoadedPolicy, candidate: Candidate, held_out: HeldOut) -> Replay:
    """Execute a candidate's chunks at the observations of held-out episodes."""
    execute(policy, candidate.values)
    demonstrated = held_out.demonstrated
    rows = commands_at(policy, held_out.observations, list(demonstrated.episodes))
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
