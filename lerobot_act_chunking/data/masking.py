"""Padded steps behind the end of an episode: what stands there, and averages that leave them out."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from lerobot_act_chunking.nn.masking import PadNormalization, per_sample_error

__all__ = ["PadNormalization", "hold_padding", "per_sample_error"]


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
