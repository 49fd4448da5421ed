"""The samplers by name."""

import torch

from lerobot_act_chunking.errors import ConfigurationError, unknown_choice
from lerobot_act_chunking.sampling import diffusion
from lerobot_act_chunking.sampling.process import Diffusion, Flow, Process
from lerobot_act_chunking.sampling.solvers import Denoise, LinearSampler, Sampler, deterministic_steps

__all__ = ["CLIP_MODES", "SAMPLERS", "SPACINGS", "Denoise", "Sampler", "check_sampler", "make_sampler"]

SAMPLERS = {  # by the name of the process; the first is the default
    "ddpm": ("ddim", "ddpm"),
    "flow": ("euler",),
}
SPACINGS = ("leading", "trailing", "linspace")
CLIP_MODES = ("consistent", "lerobot")


def check_sampler(
    process_name: str,
    name: str,
    num_inference_steps: int,
    *,
    num_train_timesteps: int = 100,
    spacing: str | None = None,
    strength: float = 1,
    clip_mode: str = "consistent",
) -> None:
    """Refuse what `make_sampler` would refuse; cheap, for configurations.

    Raises:
        ConfigurationError: says what does not fit, and what would.
    """
    if process_name not in SAMPLERS:
        raise unknown_choice("process", process_name, SAMPLERS)
    if name not in SAMPLERS[process_name]:
        raise unknown_choice(f"sampler of {process_name}", name, SAMPLERS[process_name])
    if clip_mode not in CLIP_MODES:
        raise unknown_choice("clip_mode", clip_mode, CLIP_MODES)
    if num_inference_steps < 1:
        raise ConfigurationError(f"num_inference_steps must be at least 1, but is {num_inference_steps}")
    if not 0 < strength <= 1:
        raise ConfigurationError(f"strength must be above 0 and at most 1, but is {strength}")


def make_sampler(
    process: Process,
    name: str,
    num_inference_steps: int,
    *,
    spacing: str | None = None,
    strength: float = 1,
    clip: float | None = None,
    clip_mode: str = "consistent",
) -> Sampler:
    """A sampler for this process.

    Args:
        process: the process that the network was trained with.
        name: one of ``SAMPLERS[process.name]``.
        num_inference_steps: number of steps.
        spacing: of the steps of ``ddim`` and ``ddpm``, as diffusers has it; None is ``leading``.
        strength: below 1, start from noised actions, at the time of evaluation that is nearest to this
            fraction of the way from actions to noise (SDEdit, Meng et al. 2022), with the fewer steps left.
        clip: bound of the clean actions in every evaluation; None does not clip.
        clip_mode: ``consistent`` lets all else follow from the clipped estimate; ``lerobot`` keeps the noise
            that the network meant, as LeRobot's ``ddim`` does (``ddpm`` knows no difference).

    Raises:
        ConfigurationError: what `check_sampler` refuses.
    """
    check_sampler(
        process.name, name, num_inference_steps, spacing=spacing, strength=strength, clip_mode=clip_mode
    )
    if isinstance(process, Diffusion):
        return diffusion.make(process, name, num_inference_steps, spacing, strength, clip, clip_mode)
    assert isinstance(process, Flow)
    start = min(round((1 - strength) * num_inference_steps), num_inference_steps - 1)
    times = torch.arange(start, num_inference_steps + 1) / num_inference_steps
    levels = [(t, 1 - t) for t in times.tolist()]
    return LinearSampler(times[:-1], clip, deterministic_steps(levels))
