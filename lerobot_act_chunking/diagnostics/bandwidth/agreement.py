"""What the real executor does to a fake policy whose innovations are known."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.bandwidth.filter import InnovationFilter
from lerobot_act_chunking.execution.executor import ChunkExecutor

STEP_TOLERANCE = 1e-6
NOISE_TOLERANCE = 0.05
REALISATIONS = 32  # of the noise, side by side as action dimensions

# Innovation of the chunk computed at a control step, per action dimension (A,).
Innovations = Callable[[int], np.ndarray]


@dataclass(frozen=True)
class Agreement:
    """Largest differences between the executor and the closed form.

    Attributes:
        step_error: of the step response, over every replan phase and every step.
        plan_error: of the plan, which must pass with gain 1 and no delay.
        noise_error: of H(f), by the cross-spectrum of white noise and command, over ``frequency``.
        frequency: frequencies [cycles/step] of ``response``.
        response: H(f) as measured, complex.
    """

    step_error: float
    plan_error: float
    noise_error: float
    frequency: np.ndarray = field(repr=False)
    response: np.ndarray = field(repr=False)

    @property
    def agrees(self) -> bool:
        """Whether the executor is the filter that the closed form describes."""
        deterministic = max(self.step_error, self.plan_error)
        return bool(deterministic <= STEP_TOLERANCE and self.noise_error <= NOISE_TOLERANCE)


def check_agreement(settings: ExecutionSettings, kernel: InnovationFilter, seed: int = 0) -> Agreement:
    """Drive the executor with steps and with white noise and compare it with ``kernel``.

    Args:
        settings: a mode that has a closed form.
        kernel: its closed form.
        seed: of the noise.
    """
    step_error, plan_error = _step_errors(settings, kernel)
    frequency, response = measure_response(settings, np.random.default_rng(seed))
    noise_error = np.abs(response - kernel.response(frequency)).max()
    return Agreement(step_error, plan_error, float(noise_error), frequency, response)


def execute(settings: ExecutionSettings, innovations: Innovations, n_steps: int) -> np.ndarray:
    """Commands minus plan, (n_steps, A), of a policy whose chunk from step s is the plan plus a constant.

    Args:
        settings: how chunks are executed. Grippers, which follow the newest chunk, are left out, and so is
            smoothing within a chunk, which acts on the plan alone.
        innovations: the constants.
        n_steps: length of the rollout.
    """
    settings = replace(settings, gripper_dims=(), smoothing_steps=1)
    executor = ChunkExecutor(settings)
    steps = np.arange(n_steps + settings.chunk_size)
    plan = np.sin(0.7 * steps) + 0.01 * steps  # fast and drifting: any delay would show
    step = 0

    def predict(_: Tensor | None) -> Tensor:
        chunk = plan[step : step + settings.chunk_size, None] + innovations(step)
        return torch.from_numpy(chunk)[None]

    commands = []
    for step in range(n_steps):  # noqa: B007  (predict reads it)
        commands.append(executor.step(predict, 1)[0].numpy())
    return np.stack(commands) - plan[:n_steps, None]


def _step_errors(settings: ExecutionSettings, kernel: InnovationFilter) -> tuple[float, float]:
    """Errors of the step response and of the plan; dimension p has its event p steps after a replan."""
    interval = kernel.replan_interval
    start = -(-settings.n_action_steps // interval) * interval  # a replan, with every cell in steady state
    events = start + np.arange(interval)
    n_steps = int(events[-1]) + len(kernel.impulse) + 1
    executed = execute(settings, lambda step: (step >= events).astype(float), n_steps)
    errors = []
    for column, event in enumerate(events):
        expected = np.ones(n_steps - event)
        shares = kernel.step(wait=int(-event % interval))[: len(expected)]
        expected[: len(shares)] = shares
        errors.append(np.abs(executed[event:, column] - expected).max())
    return float(max(errors)), float(np.abs(executed[:start]).max())


def measure_response(
    settings: ExecutionSettings, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """H(f) of the executor by the cross-spectrum of white noise and command.

    The noise repeats after a period that holds two filter lengths, so there is no leakage; each replan phase
    is a filter of its own at the replan rate, so what R > 1 folds from other frequencies does not mix in.

    Returns:
        Frequencies [cycles/step] from 0 to 1/2, and H there, complex.
    """
    interval = settings.replan_interval
    blocks = max(2 * -(-settings.n_action_steps // interval), 16)
    period = blocks * interval
    noise = generator.standard_normal((blocks, REALISATIONS))
    settled = -(-settings.n_action_steps // period) * period
    executed = execute(settings, lambda step: noise[step // interval % blocks], settled + period)
    inputs = np.fft.fft(noise, axis=0)[:, None]
    outputs = np.fft.fft(executed[settled:].reshape(blocks, interval, -1), axis=0)
    phases = (outputs * inputs.conj()).sum(-1) / np.square(np.abs(inputs)).sum(-1)  # (blocks, R)
    bins = np.arange(period // 2 + 1)
    delays = np.exp(-2j * np.pi * np.outer(bins, np.arange(interval)) / period)
    return bins / period, (phases[bins % blocks] * delays).mean(1)
