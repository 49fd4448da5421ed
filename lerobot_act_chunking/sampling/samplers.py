"""The samplers by name."""

from typing import Literal, get_args

import torch

from lerobot_act_chunking.errors import ConfigurationError, unknown_choice
from lerobot_act_chunking.sampling.diffusion import make_diffusion_sampler
from lerobot_act_chunking.sampling.flow import make_flow_sampler
from lerobot_act_chunking.sampling.process import Diffusion, Process, TwoStep
from lerobot_act_chunking.sampling.solvers import Denoise, Sampler
from lerobot_act_chunking.sampling.two_step import TwoStepSampler

__all__ = ["CLIP_MODES", "SAMPLERS", "SPACINGS", "Denoise", "Sampler", "check_sampler", "make_sampler"]

SAMPLERS = {  # by the name of the process; the first is the usual one
    "flow": ("euler", "midpoint", "heun", "rk4"),
    "ddpm": ("ddim", "ddpm", "dpm++"),
    "two_step": ("two_step",),
}
Spacing = Literal["leading", "trailing", "linspace"]
SPACINGS = get_args(Spacing)
CLIP_MODES = ("consistent", "lerobot")


def make_sampler(
    process: Process,
    name: str,
    num_inference_steps: int,
    *,
    spacing: str | None = None,
    strength: float = 1.0,
    clip: float | None = None,
    clip_mode: str = "consistent",
) -> Sampler:
    """A sampler for this process; make it once and keep it.

    ``ddim`` (Song et al. 2021, without noise), ``ddpm`` (Ho et al. 2020), ``dpm++`` (DPM-Solver++ 2M, Lu et
    al. 2022); ``euler``, ``midpoint``, ``heun``, ``rk4``; ``two_step`` (Pan et al. 2025).

    Args:
        process: the process that the network was trained with.
        name: one of ``SAMPLERS[process.name]``.
        num_inference_steps: number of steps. Evaluations are as many, but about twice as many for
            ``midpoint`` and ``heun``, four times for ``rk4``: see ``len(sampler.times)``.
        spacing: which training steps ``ddim`` and ``ddpm`` visit, as in diffusers (Lin et al. 2024, table 2);
            None is ``leading``, LeRobot's. It starts below the noisiest step, the lower the fewer steps.
        strength: below 1, start from noised actions, at the time of evaluation that is nearest to this
            fraction of the way from actions to noise (SDEdit, Meng et al. 2022), with the steps from there.
        clip: bound of the clean actions in every evaluation; None does not clip.
        clip_mode: ``consistent`` lets all else follow from the clipped estimate; ``lerobot`` keeps the noise
            that the network meant, as LeRobot's ``ddim`` does. ``ddpm`` knows no difference.

    Raises:
        ConfigurationError: what `check_sampler` refuses.
    """
    check_sampler(
        process.name,
        name,
        num_inference_steps,
        num_train_timesteps=process.num_train_timesteps if isinstance(process, Diffusion) else 0,
        spacing=spacing,
        strength=strength,
        clip_mode=clip_mode,
    )
    match process:
        case Diffusion():
            return make_diffusion_sampler(
                process,
                name,
                num_inference_steps,
                spacing=spacing,
                strength=strength,
                clip=clip,
                clip_mode=clip_mode,
            )
        case TwoStep():
            return TwoStepSampler(torch.tensor([0.0, process.refine_time]), clip)
        case _:
            return make_flow_sampler(name, num_inference_steps, strength=strength, clip=clip)


def check_sampler(
    process_name: str,
    name: str,
    num_inference_steps: int,
    *,
    num_train_timesteps: int,
    spacing: str | None = None,
    strength: float = 1.0,
    clip_mode: str = "consistent",
) -> None:
    """Refuse what `make_sampler` would refuse; cheap, for configurations.

    Args:
        process_name: ``ddpm``, ``flow`` or ``two_step``.
        name: see `make_sampler`, as all others.
        num_inference_steps: number of steps.
        num_train_timesteps: of ``ddpm``.
        spacing: None for the sampler's own.
        strength: fraction of the way from actions to noise.
        clip_mode: how a clipped estimate is gone on with.

    Raises:
        ConfigurationError: an unknown name or one for another process, or numbers that cannot work together.
    """
    if process_name not in SAMPLERS:
        raise unknown_choice("process", process_name, SAMPLERS)
    if name not in SAMPLERS[process_name]:
        raise unknown_choice(f"sampler for {process_name}", name, SAMPLERS[process_name])
    if clip_mode not in CLIP_MODES:
        raise unknown_choice("clip_mode", clip_mode, CLIP_MODES)
    if clip_mode == "lerobot" and name not in ("ddim", "ddpm"):
        raise ConfigurationError(
            f"clip_mode 'lerobot' is for ddim and ddpm, not for {name}: set clip_mode=consistent"
        )
    if num_inference_steps < 1:
        raise ConfigurationError(f"num_inference_steps must be at least 1, but is {num_inference_steps}")
    if not 0 < strength <= 1:
        raise ConfigurationError(f"strength must be above 0 and at most 1, but is {strength}")
    _check_spacing(name, num_inference_steps, spacing)
    if process_name == "ddpm":
        _check_train_steps(name, num_inference_steps, num_train_timesteps)
    if process_name == "two_step":
        _check_two_step(num_inference_steps, strength)


def _check_spacing(name: str, num_inference_steps: int, spacing: str | None) -> None:
    if spacing is not None and spacing not in SPACINGS:
        raise unknown_choice("timestep spacing", spacing, SPACINGS)
    if name in ("ddim", "ddpm"):
        if num_inference_steps == 1 and spacing != "trailing":
            raise ConfigurationError(
                f"one step of {name} with {spacing or 'leading'} spacing takes the noise for nearly clean "
                "actions: set timestep_spacing=trailing, or num_inference_steps=2 or more"
            )
    elif name == "dpm++":
        if spacing not in (None, "trailing"):
            raise ConfigurationError(
                f"dpm++ has trailing timestep spacing, not {spacing!r}: set timestep_spacing=null"
            )
    elif spacing is not None:
        raise ConfigurationError(
            f"{name} has no timestep spacing, but it is {spacing!r}: set timestep_spacing=null"
        )


def _check_train_steps(name: str, num_inference_steps: int, num_train_timesteps: int) -> None:
    if num_inference_steps > num_train_timesteps:
        raise ConfigurationError(
            f"num_inference_steps, {num_inference_steps}, is above num_train_timesteps, {num_train_timesteps}"
        )
    if name == "dpm++" and 2 * num_inference_steps > num_train_timesteps:
        raise ConfigurationError(
            f"dpm++ with {num_inference_steps} of {num_train_timesteps} training steps divides by zero where "
            f"two steps meet: set num_inference_steps={num_train_timesteps // 2} or less, or sampler=ddim"
        )


def _check_two_step(num_inference_steps: int, strength: float) -> None:
    if num_inference_steps != 2:
        raise ConfigurationError(f"two_step makes 2 steps, but num_inference_steps is {num_inference_steps}")
    if strength < 1:
        raise ConfigurationError(f"two_step does not start from noised actions, but strength is {strength}")
