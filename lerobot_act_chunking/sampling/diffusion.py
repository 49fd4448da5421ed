"""Samplers of DDPM-style diffusion as tables: their times and weights, from diffusers' schedulers.

All of these samplers take linear steps, whose weights are known before the first evaluation. From a table a
step takes a tenth of the time of a scheduler's own, and there is no state that two threads could not share.
"""

import warnings
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.sampling.process import Diffusion
from lerobot_act_chunking.sampling.solvers import LinearSampler, Step, deterministic_steps

MIN_LOG_SNR = -5.1  # DPM-Solver++ starts above it: its steps in log(alpha / sigma) are unbounded below


def make_diffusion_sampler(
    process: Diffusion,
    name: str,
    num_inference_steps: int,
    *,
    spacing: str | None,
    strength: float,
    clip: float | None,
    clip_mode: str,
) -> LinearSampler:
    """``ddim``, ``ddpm`` or ``dpm++``; see `make_sampler`. The arguments are checked."""
    scheduler = _scheduler(process, name, num_inference_steps, spacing)
    times = scheduler.timesteps.float()
    start = _start(times, strength * (process.num_train_timesteps - 1)) if strength < 1 else 0
    times = times[start:]
    match name:
        case "dpm++":
            steps = _steps_of(scheduler, start)
        case "ddpm":
            steps = ancestral_steps(_levels(process, times))
        case _:
            steps = deterministic_steps(_levels(process, times), keep_direction=clip_mode == "lerobot")
    return LinearSampler(times, clip, steps)


def ancestral_steps(levels: Sequence[tuple[float, float]]) -> tuple[Step, ...]:
    """DDPM: the posterior of the next x given x and the clean actions (Ho et al. 2020, eq. 7).

    Args:
        levels: (alpha, sigma) of every evaluation, and last of the result.
    """
    steps = []
    for (alpha, sigma), (next_alpha, next_sigma) in pairwise(levels):
        kept = alpha / next_alpha
        beta = 1 - kept**2
        shrunk = (next_sigma / sigma) ** 2
        steps.append(Step(kept * shrunk, next_alpha * beta / sigma**2, noise=(shrunk * beta) ** 0.5))
    return tuple(steps)


def _scheduler(process: Diffusion, name: str, num_inference_steps: int, spacing: str | None) -> Any:
    """With its timesteps set."""
    settings = process.scheduler_settings()
    if name == "dpm++":
        from diffusers.schedulers.scheduling_dpmsolver_multistep import DPMSolverMultistepScheduler

        scheduler = DPMSolverMultistepScheduler(
            **settings,
            solver_order=2,
            lower_order_final=True,
            final_sigmas_type="zero",
            timestep_spacing="trailing",
            lambda_min_clipped=MIN_LOG_SNR,
        )
    else:
        from diffusers.schedulers.scheduling_ddim import DDIMScheduler

        settings["timestep_spacing"] = spacing or "leading"
        scheduler = DDIMScheduler(**settings)
    with warnings.catch_warnings():  # diffusers gives tensors to NumPy in a way that NumPy 2 deprecates
        warnings.filterwarnings("ignore", "__array__ implementation", DeprecationWarning)
        scheduler.set_timesteps(num_inference_steps)
    return scheduler


def _start(times: Float[Tensor, " n"], wanted: float) -> int:
    return int((times - wanted).abs().argmin())


def _levels(process: Diffusion, times: Float[Tensor, " n"]) -> list[tuple[float, float]]:
    """Alpha and sigma of every time, and of the clean result."""
    alphas, sigmas = process.levels(torch.cat([times.double(), torch.tensor([process.clean_time])]))
    return list(zip(alphas.tolist(), sigmas.tolist(), strict=True))


def _steps_of(scheduler: Any, start: int) -> tuple[Step, ...]:
    """The weights of a scheduler that looks back one step, read off by letting it step through unit vectors.

    Args:
        scheduler: with its timesteps set.
        start: index of the first timestep to use.
    """
    scheduler.set_begin_index(start)
    n = len(scheduler.timesteps)
    x, *cleans = torch.eye(n + 1)
    steps = []
    for i in range(start, n):
        weights = scheduler.step(cleans[i], scheduler.timesteps[i], x).prev_sample.tolist()
        steps.append(Step(weights[0], weights[1 + i], of_previous=weights[i] if i > start else 0.0))
    return tuple(steps)
