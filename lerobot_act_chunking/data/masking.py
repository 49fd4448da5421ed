"""Averages that leave out the padded steps behind the end of an episode."""

from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

PadNormalization = Literal["valid", "all"]


def hold_padding(actions: Float[Tensor, "B T A"], is_pad: Bool[Tensor, "B T"]) -> Float[Tensor, "B T A"]:
    """Actions in which every padded step repeats the nearest step of the episode.

    For policies that read the actions they learn from, as denoisers do: whatever the dataset put into the
    padding, nothing of it reaches the network.
    """
    steps = torch.arange(actions.shape[1], device=actions.device)
    first = is_pad.to(torch.int64).argmin(1, keepdim=True)
    last = actions.shape[1] - 1 - is_pad.flip(1).to(torch.int64).argmin(1, keepdim=True)
    source = torch.minimum(torch.maximum(steps, first), last)
    return actions.gather(1, source[..., None].expand_as(actions))


def per_sample_error(
    error: Float[Tensor, "B T A"], is_pad: Bool[Tensor, "B T"], normalization: PadNormalization
) -> Float[Tensor, " B"]:
    """Errors of the valid steps, scaled so that their mean over the batch is the batch loss.

    With ``valid`` the batch loss is the mean over all valid elements of the batch (LeRobot): a sample
    counts by its valid steps. With ``all`` the sum is divided by all elements, padded ones included
    (original ACT), which weakens the action loss against other terms near episode ends.
    """
    total = (error * ~is_pad[..., None]).sum((1, 2))
    if normalization == "all":
        return total / error[0].numel()
    n_valid = (~is_pad).sum() * error.shape[-1]
    return total * len(is_pad) / n_valid.clamp_min(1)
