"""Averages that leave out the padded steps behind the end of an episode."""

from typing import Literal

from jaxtyping import Bool, Float
from torch import Tensor

from lerobot_act_chunking.nn.processes import counted_together

PadNormalization = Literal["valid", "all"]


def per_sample_error(
    error: Float[Tensor, "B T A"], is_pad: Bool[Tensor, "B T"], normalization: PadNormalization
) -> Float[Tensor, " B"]:
    """Errors of the valid steps, scaled so that their mean over the batch is the batch loss.

    With ``valid`` the batch loss is the mean over all valid elements of the batch (LeRobot): a sample
    counts by its valid steps. With ``all`` the sum is divided by all elements, padded ones included
    (original ACT), which weakens the action loss against other terms near episode ends.
    """
    total = (error * ~is_pad[..., None]).sum((1, 2))
    return per_element(total, is_pad, error.shape[-1], normalization)


def per_element(
    total: Float[Tensor, " B"], is_pad: Bool[Tensor, "B T"], action_dim: int, normalization: PadNormalization
) -> Float[Tensor, " B"]:
    """Sums over the valid elements of each sample, scaled as `per_sample_error` scales them."""
    if normalization == "all":
        return total / (is_pad.shape[1] * action_dim)
    n_valid = counted_together((~is_pad).sum() * action_dim)
    return total * len(is_pad) / n_valid.clamp_min(1)
