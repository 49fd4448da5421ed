"""Smoothing each chunk before it is executed."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor


def moving_mean(
    chunk: Float[Tensor, "*n T A"], steps: int, gripper_dims: Sequence[int] = ()
) -> Float[Tensor, "*n T A"]:
    """Each action replaced by the mean of the ``steps`` actions around it.

    Errors that are independent from step to step keep a ``steps``-th of their variance. The mean is centred,
    so that the motion is not delayed. Beyond its ends a chunk is continued by its first and its last action.

    Args:
        chunk: the predicted actions.
        steps: how many are averaged [control steps], an odd number; 1 changes nothing.
        gripper_dims: action dimensions that stay as they are.
    """
    if steps == 1:
        return chunk
    half = steps // 2
    first, last = chunk[..., :1, :], chunk[..., -1:, :]
    sizes = [-1] * chunk.ndim
    sizes[-2] = half
    padded = torch.cat([first.expand(sizes), chunk, last.expand(sizes)], dim=-2)
    smooth = padded.unfold(-2, steps, 1).mean(-1)
    held = list(gripper_dims)
    smooth[..., held] = chunk[..., held]
    return smooth
