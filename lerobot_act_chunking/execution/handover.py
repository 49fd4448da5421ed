"""Going over from what is left of an old chunk to a new one, for callers that execute chunks themselves."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from act_chunking_runtime.settings import ExecutionSettings

BLENDING = ("crossfade", "ensemble", "adaptive")
LEAST = 5  # control steps of a transition where the old chunk is too short for one: it holds its last action


def hand_over(
    chunk: Float[Tensor, "n T A"],
    left_over: Float[Tensor, "#n P A"],
    covered: Bool[Tensor, "#n P"],
    delay: int,
    settings: ExecutionSettings,
) -> Float[Tensor, "n T A"]:
    """The new chunk as it will be executed: the old one while it is computed, then a linear transition.

    Args:
        chunk: from the current step on.
        left_over: what is left of the old one, from the current step on.
        covered: which of its steps there are.
        delay: control steps until the new chunk is used.
        settings: ``crossfade_steps`` is the length of the transition; that of the overlap with other modes
            that blend, none with those that do not. ``gripper_dims`` go over at once.
    """
    if settings.execution in BLENDING:
        least = min(settings.crossfade_steps or LEAST, LEAST)
        left_over, covered = _held(left_over, covered, delay, min(delay + least, chunk.shape[1]))
    n_common = min(chunk.shape[1], left_over.shape[1])
    old, reached = left_over[:, :n_common].to(chunk), covered[:, :n_common].to(chunk.device)
    step = torch.arange(n_common, device=chunk.device)
    length = reached.sum(1, keepdim=True).sub(delay).clamp(min=0)
    if settings.execution not in BLENDING:
        length = torch.zeros_like(length)
    elif settings.crossfade_steps is not None:
        length = length.clamp(max=settings.crossfade_steps)
    new = ((step + 1 - delay) / (length + 1)).clamp(0, 1)
    share = torch.where(reached, new, 1.0)[..., None].repeat(1, 1, chunk.shape[2])
    at_once = torch.where(reached, (step >= delay).to(new), 1.0)
    for dim in settings.gripper_dims:
        share[..., dim] = at_once
    return torch.cat((torch.lerp(old, chunk[:, :n_common], share), chunk[:, n_common:]), dim=1)


def _held(
    left_over: Float[Tensor, "n P A"], covered: Bool[Tensor, "n P"], delay: int, steps: int
) -> tuple[Float[Tensor, "n T A"], Bool[Tensor, "n T"]]:
    """What is left; of what ends within the delay, its last action is held for so many steps in all."""
    n, length, n_dims = left_over.shape
    ends = covered.sum(1, keepdim=True).expand(n, -1)
    step = torch.arange(max(steps, length), device=left_over.device).expand(n, -1)
    filled = left_over.gather(
        1, torch.minimum(step, (ends - 1).clamp(min=0))[..., None].expand(-1, -1, n_dims)
    )
    until = torch.where((ends > 0) & (ends <= delay), steps, ends)
    return filled, step < until
