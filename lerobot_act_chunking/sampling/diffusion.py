"""Samplers of DDPM-style diffusion as tables: their times and weights, from diffusers' schedulers.

Every such sampler takes linear steps, whose weights are known before the first evaluation. From a table the
update is two operations; `scheduler.step` takes many times as long, about as long as a small network.
"""

import torch

from lerobot_act_chunking.sampling.process import Diffusion
from lerobot_act_chunking.sampling.solvers import LinearSampler, Step, deterministic_steps


def make(
    process: Diffusion,
    name: str,
    num_inference_steps: int,
    spacing: str | None,
    strength: float,
    clip: float | None,
    clip_mode: str,
) -> LinearSampler:
    times = _times(process, num_inference_steps, spacing or "leading", strength)
    alphas, sigmas = process.levels(times)
    levels = [*zip(alphas.double().tolist(), sigmas.double().tolist(), strict=True), (1.0, 0.0)]
    if name == "ddim":
        steps = deterministic_steps(levels, keep_direction=clip_mode == "lerobot")
    else:
        steps = _ancestral_steps(levels)
    return LinearSampler(times, clip, steps)


def _times(process, num_inference_steps, spacing, strength):
    from diffusers.schedulers.scheduling_ddim import DDIMScheduler

    scheduler = DDIMScheduler(**process.scheduler_settings(), timestep_spacing=spacing)
    scheduler.set_timesteps(num_inference_steps)
    times = scheduler.timesteps.float()
    start = (times - strength * (process.num_train_timesteps - 1)).abs().argmin() if strength < 1 else 0
    return times[start:]


def _ancestral_steps(levels) -> tuple[Step, ...]:
    """DDPM (Ho et al. 2020, eq. 7) with the posterior's variance."""
    steps = []
    for (alpha, sigma), (next_alpha, next_sigma) in zip(levels, levels[1:], strict=False):
        kept = alpha / next_alpha
        beta = 1 - kept**2
        shrink = (next_sigma / sigma) ** 2
        steps.append(Step(kept * shrink, next_alpha * beta / sigma**2, noise=(shrink * beta) ** 0.5))
    return tuple(steps)
