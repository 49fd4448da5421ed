"""Actions as histograms over equal bins of [-1, 1], and back."""

import math

import torch
from jaxtyping import Float, Int64
from torch import Tensor

REACH = 4.5  # standard deviations of a soft target that are kept: all but a few millionths


def soft_targets(
    actions: Float[Tensor, "*S"], n_bins: int, sigma: float
) -> tuple[Int64[Tensor, "*S W"], Float[Tensor, "*S W"]]:
    """Bins near each action, and the probability of each: HL-Gauss (Imani and White 2018, section 3).

    The probability of a bin is the mass in it of a normal distribution around the action, of all that lies in
    [-1, 1]. Bins out of reach have none and are left out; W is the same for all actions.

    Args:
        actions: those outside [-1, 1] count as at its ends.
        n_bins: bins over [-1, 1].
        sigma: standard deviation in bins; 0 gives all to the action's own bin.
    """
    position = ((actions.clamp(-1, 1) + 1) * (n_bins / 2))[..., None]  # in bins from the lower end
    reach = math.ceil(REACH * sigma)
    own = position.floor().clamp(max=n_bins - 1)
    bins = own + torch.arange(-reach, reach + 1, device=actions.device, dtype=actions.dtype)
    there = (bins >= 0) & (bins < n_bins)
    if sigma == 0:
        return bins.long(), torch.ones_like(bins)
    upper, lower = ((bins + end - position) / sigma for end in (1, 0))
    mass = (torch.special.ndtr(upper) - torch.special.ndtr(lower)) * there
    return bins.long().clamp(0, n_bins - 1), mass / mass.sum(-1, keepdim=True)


def cross_entropy(
    logits: Float[Tensor, "*S M"], bins: Int64[Tensor, "*S W"], mass: Float[Tensor, "*S W"]
) -> Float[Tensor, "*S"]:
    """Cross-entropy [nats] of soft targets that lie in a few bins: nothing else of size M is made."""
    return logits.logsumexp(-1) - (logits.gather(-1, bins) * mass).sum(-1)


def soft_local(logits: Float[Tensor, "*S M"], bins: Int64[Tensor, "*S"], reach: int) -> Float[Tensor, "*S"]:
    """The expected action, given that it lies within ``reach`` bins of these; with reach 0, their centres."""
    n_bins = logits.shape[-1]
    near = bins[..., None] + torch.arange(-reach, reach + 1, device=bins.device)
    outside = (near < 0) | (near >= n_bins)
    near = near.clamp(0, n_bins - 1)
    shares = logits.gather(-1, near).masked_fill(outside, -math.inf).softmax(-1)
    return (shares * ((near + 0.5) * (2 / n_bins) - 1)).sum(-1)
