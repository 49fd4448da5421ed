"""Step responses of the modes whose weights depend on what the chunks say: measured, there is no formula."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.bandwidth.filter import settle_steps
from lerobot_act_chunking.execution.executor import ChunkExecutor

STEP_SIZES = (1.0, 3.0, 10.0)
_ACTION_DIMS = 4
_CELLS = 10_000_000  # that the executor may remember, to bound its memory
_MOST_ENVS = 16


@dataclass(frozen=True)
class MeasuredStep:
    """Response of the executor to a step in the demanded command, between chunks that differ by noise.

    Attributes:
        size: of the step, in standard deviations by which two chunks differ in each action dimension.
        settle_90_steps: control steps from the event, just before an inference, until 90 % are executed.
        shares: share of the step executed n control steps after it, mean over environments.
    """

    size: float
    settle_90_steps: int
    shares: list[float]


def measure_steps(settings: ExecutionSettings, seed: int = 0) -> list[MeasuredStep]:
    """Step responses of the real executor for steps of ``STEP_SIZES``.

    Each chunk is a plan plus a constant of its own, white over chunks, dimensions and environments. The same
    rollout is run with and without the step; their difference, divided by the step, is the response.
    """
    settings = replace(settings, gripper_dims=())
    n_chunks = settings.overlapping_chunks
    n_envs = int(np.clip(_CELLS // (n_chunks * settings.n_action_steps * _ACTION_DIMS), 1, _MOST_ENVS))
    start = -(-2 * settings.n_action_steps // settings.replan_interval) * settings.replan_interval
    n_steps = start + settings.n_action_steps + 1
    samples = settings.n_samples or 1
    noise = np.random.default_rng(seed).normal(0, 0.5**0.5, (n_steps, samples, n_envs, 1, _ACTION_DIMS))

    def run(size: float) -> np.ndarray:
        return _execute(settings, lambda step: noise[step] + size * (step >= start), n_steps)[start:]

    steady = run(0.0)
    return [_measured(size, (run(size) - steady).mean((1, 2)) / size) for size in STEP_SIZES]


def _measured(size: float, shares: np.ndarray) -> MeasuredStep:
    return MeasuredStep(size, settle_steps(shares, 0.9), shares.tolist())


def _execute(settings: ExecutionSettings, offsets: Callable[[int], np.ndarray], n_steps: int) -> np.ndarray:
    """Commands (n_steps, B, A) of a policy whose chunks are constant, offsets (N, B, 1, A) per step."""
    executor = ChunkExecutor(settings)
    step = 0

    def predict(envs: Tensor | None) -> Tensor:
        values = offsets(step).repeat(settings.chunk_size, axis=2)
        chunks = torch.from_numpy(values if settings.execution == "coherence" else values[0])
        return chunks if envs is None else chunks.index_select(-3, envs)

    batch_size = offsets(0).shape[1]
    commands = []
    for step in range(n_steps):  # noqa: B007  (predict reads it)
        commands.append(executor.step(predict, batch_size).numpy())
    return np.stack(commands)
