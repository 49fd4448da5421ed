"""What chunking does to a motion: jumps where a new chunk takes over, and how far chunks disagree."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_act_chunking.diagnostics.core.episodes import evenly
from lerobot_act_chunking.diagnostics.core.rollouts import Rollout
from lerobot_act_chunking.diagnostics.core.trajectories import Trajectories, UndefinedMeasureError

MAX_AGES = 24
MAX_PAIRS = 32
"""Pairs of chunks compared per episode and age, evenly spread over the episode."""
FEWEST_ELSEWHERE = 0.5
"""Changes away from boundaries that a comparison needs, per change at one."""
PROFILE_STEPS = 10


def boundary_steps(rollout: Rollout, latency_steps: int = 0) -> np.ndarray:
    """Control steps at which a new chunk is first used; the episode's first chunk takes over from nothing."""
    used_from = np.array([inference.step + latency_steps for inference in rollout.inferences[1:]], int)
    return np.unique(used_from[used_from < len(rollout.commands)])


def boundary_ratio(trajectories: Trajectories, boundaries: Sequence[np.ndarray], order: int = 1) -> float:
    """Median change at chunk boundaries over the median change elsewhere; 1 is seamless, more is a jump.

    Args:
        trajectories: ``(T, D)`` each.
        boundaries: of each trajectory, the steps b where a new chunk begins: the change is from b - 1 to b.
        order: 1 compares ``‖x_b - x_{b-1}‖``, 2 the second differences (accelerations) that end in b; all
            differences across a boundary are kept out of "elsewhere".

    Raises:
        UndefinedMeasureError: no boundaries, hardly anything but boundaries, or no motion elsewhere.
    """
    at, elsewhere = [], []
    for trajectory, starts in zip(trajectories, boundaries, strict=True):
        changes = np.linalg.norm(np.diff(trajectory, order, axis=0), axis=1)
        index = starts[(starts >= order) & (starts < len(trajectory))] - order
        at.append(changes[index])
        across = (index[:, None] + np.arange(order)).ravel()
        elsewhere.append(np.delete(changes, across[across < len(changes)]))
    at, elsewhere = np.concatenate(at), np.concatenate(elsewhere)
    if not len(at):
        raise UndefinedMeasureError("no chunk boundary: no replanning is known of")
    if len(elsewhere) < FEWEST_ELSEWHERE * len(at):
        raise UndefinedMeasureError("a new chunk at almost every step leaves too little to compare with")
    return _ratio(at, elsewhere)


def boundary_to_plan_ratio(
    rollouts: Sequence[Rollout], dims: Sequence[int], scale: np.ndarray, latency_steps: int = 0
) -> float:
    """Median executed step into a new chunk over the step which that chunk itself plans next.

    1 is seamless. It needs no "elsewhere", so it also holds for policies that replan at every step.

    Args:
        rollouts: with logged chunks.
        dims: the action dimensions looked at.
        scale: what counts as 1 in each of the A dimensions, ``(A,)``.
        latency_steps: steps after an inference at which its chunk is first used.

    Raises:
        UndefinedMeasureError: no boundaries, no logged chunks, or chunks that plan no motion.
    """
    executed, planned = [], []
    for rollout in rollouts:
        for inference in rollout.inferences[1:]:
            step = inference.step + latency_steps
            if step < len(rollout.commands) and len(inference.chunk) > latency_steps + 1:
                executed.append(rollout.commands[step] - rollout.commands[step - 1])
                planned.append(inference.chunk[latency_steps + 1] - inference.chunk[latency_steps])
    if not executed:
        raise UndefinedMeasureError("no chunk boundary with a logged chunk")
    sizes = [np.linalg.norm((np.stack(steps) / scale)[:, dims], axis=1) for steps in (executed, planned)]
    return _ratio(*sizes)


def boundary_profile(trajectories: Trajectories, boundaries: Sequence[np.ndarray]) -> np.ndarray:
    """Median step at b - 10 ... b + 10 over the median of all steps, ``(21,)``; b is where a chunk begins.

    Raises:
        UndefinedMeasureError: no boundary lies 10 steps inside its episode, most have another within 5 steps,
            or nothing moves.
    """
    gaps = np.concatenate([np.diff(starts) for starts in boundaries])
    if len(gaps) and np.median(gaps) <= PROFILE_STEPS // 2:
        raise UndefinedMeasureError("chunk boundaries follow each other too closely for a profile")
    offsets = np.arange(-PROFILE_STEPS, PROFILE_STEPS + 1)
    windows, all_steps = [], []
    for trajectory, starts in zip(trajectories, boundaries, strict=True):
        steps = np.linalg.norm(np.diff(trajectory, axis=0), axis=1)
        inside = starts[(starts > PROFILE_STEPS) & (starts + PROFILE_STEPS <= len(steps))] - 1
        windows.append(steps[inside[:, None] + offsets])
        all_steps.append(steps)
    windows, usual = np.concatenate(windows), np.median(np.concatenate(all_steps))
    if not len(windows) or usual == 0:
        raise UndefinedMeasureError("no chunk boundary well inside an episode, or no motion")
    return np.median(windows, axis=0) / usual


@dataclass(frozen=True)
class Disagreement:
    """How far two chunks' predictions for the same steps lie apart, by the age between the chunks.

    Attributes:
        ages: control steps between the two inferences, ``(N,)``, ascending.
        mean_squares: of the scaled difference over all shared steps and pairs, ``(N, A)``.
        pairs: pairs of chunks compared, ``(N,)``.
    """

    ages: np.ndarray
    mean_squares: np.ndarray
    pairs: np.ndarray

    def rms(self, dims: Sequence[int]) -> np.ndarray:
        """Root mean square over some dimensions, ``(N,)``, in units of the scale."""
        return np.sqrt(self.mean_squares[:, dims].mean(1))


def disagreement(rollouts: Sequence[Rollout], scale: np.ndarray) -> Disagreement:
    """Compare overlapping chunks, at up to `MAX_AGES` ages spread over all that occur.

    Args:
        rollouts: with logged chunks.
        scale: what counts as 1 in each of the A dimensions, ``(A,)``; usually the actions' std.

    Raises:
        UndefinedMeasureError: no chunks were logged, or none overlaps another.
    """
    episodes = [
        (np.array([inference.step for inference in rollout.inferences]), _chunks(rollout, scale))
        for rollout in rollouts
        if len(rollout.inferences) > 1 and len(rollout.inferences[0].chunk)
    ]
    if not episodes:
        raise UndefinedMeasureError("fewer than two chunks were logged in every episode")
    ages = _ages(episodes)
    if not len(ages):
        raise UndefinedMeasureError("chunks never overlap: each begins where the one before it ends")
    squares, samples, pairs = np.zeros((len(ages), len(scale))), np.zeros(len(ages)), np.zeros(len(ages), int)
    for steps, chunks in episodes:
        for i, age in enumerate(ages):
            older, newer = _pairs(steps, age)
            gap = chunks[older, age:] - chunks[newer, : chunks.shape[1] - age]
            squares[i] += np.square(gap).sum((0, 1))
            samples[i] += gap.shape[0] * gap.shape[1]
            pairs[i] += len(older)
    return Disagreement(ages, squares / samples[:, None], pairs)


def _chunks(rollout: Rollout, scale: np.ndarray) -> np.ndarray:
    return np.stack([inference.chunk for inference in rollout.inferences]) / scale


def _ages(episodes: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Ages of overlapping chunks that occur, at most `MAX_AGES` of them, evenly spread."""
    occurs = np.zeros(max(chunks.shape[1] for _, chunks in episodes), bool)
    for steps, chunks in episodes:
        inferred = np.zeros(steps[-1] + 1)
        inferred[steps] = 1
        counts = np.correlate(inferred, inferred, "full")[len(inferred) - 1 :][: chunks.shape[1]]
        occurs[: len(counts)] |= counts > 0
    ages = np.flatnonzero(occurs[1:]) + 1
    return ages[evenly(len(ages), MAX_AGES)]


def _pairs(steps: np.ndarray, age: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices of inferences that lie ``age`` steps apart, at most `MAX_PAIRS`, evenly spread."""
    older = np.flatnonzero(np.isin(steps + age, steps))
    older = older[evenly(len(older), MAX_PAIRS)]
    return older, np.searchsorted(steps, steps[older] + age)


def _ratio(at: np.ndarray, usual: np.ndarray) -> float:
    middle = np.median(usual)
    if middle == 0:
        raise UndefinedMeasureError("the median step elsewhere is 0: nothing moves most of the time")
    return float(np.median(at) / middle)
