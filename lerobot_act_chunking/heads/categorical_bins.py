"""Actions as histograms over equal bins, and back.

M bins cover [-limit, limit], where soft targets of actions at -1 and 1 still have room for their tails: cut
off, they would draw the grippers and joints that rest at an end of their range away from it.
"""

import math

import torch
from jaxtyping import Float, Int64
from torch import Tensor

TAIL = 4.5  # standard deviations of a soft target that are kept: all but a few millionths


def tail_bins(sigma: float) -> int:
    """Bins on either side of an action's own that its soft target of ``sigma`` bins covers."""
    return math.ceil(TAIL * sigma)


def bin_limit(n_bins: int, sigma: float) -> float:
    """The end of the outermost bin: 1 lies as many bins before it as a tail needs."""
    return n_bins / (n_bins - 2 * tail_bins(sigma))


def soft_targets(
    actions: Float[Tensor, "*S"], n_bins: int, sigma: float
) -> tuple[Int64[Tensor, "*S W"], Float[Tensor, "*S W"]]:
    """Bins near each action, and the probability of each: HL-Gauss (Imani and White 2018, section 3).

    The probability of a bin is the mass in it of a normal distribution around the action. Other bins have
    none and are left out; W is the same for all actions.

    Args:
        actions: those outside [-1, 1] count as at its ends.
        n_bins: M, more than two tails.
        sigma: standard deviation in bins; 0 gives all to the action's own bin.
    """
    position = ((actions.clamp(-1, 1) / bin_limit(n_bins, sigma) + 1) * (n_bins / 2))[..., None]
    tail = tail_bins(sigma)
    own = position.floor().clamp(tail, n_bins - 1 - tail)
    bins = own + torch.arange(-tail, tail + 1, device=actions.device)
    if sigma == 0:
        return bins.long(), torch.ones_like(bins)
    upper, lower = (torch.special.ndtr((bins + end - position) / sigma) for end in (1, 0))
    mass = upper - lower
    return bins.long(), mass / mass.sum(-1, keepdim=True)


def cross_entropy(
    logits: Float[Tensor, "*S M"], bins: Int64[Tensor, "*S W"], mass: Float[Tensor, "*S W"]
) -> Float[Tensor, "*S"]:
    """Cross-entropy [nats] of soft targets that lie in a few bins: nothing else of size M is made."""
    return logits.logsumexp(-1) - (logits.gather(-1, bins) * mass).sum(-1)


def soft_local(
    logits: Float[Tensor, "*S M"], bins: Int64[Tensor, "*S"], reach: int, limit: float
) -> Float[Tensor, "*S"]:
    """The expected action, given that it lies within ``reach`` bins of these; with reach 0, their centres."""
    n_bins = logits.shape[-1]
    near = bins[..., None] + torch.arange(-reach, reach + 1, device=bins.device)
    outside = (near < 0) | (near >= n_bins)
    near = near.clamp(0, n_bins - 1)
    shares = logits.gather(-1, near).masked_fill(outside, -math.inf).softmax(-1)
    return (shares * ((2 * near + 1).to(shares) / n_bins - 1)).sum(-1) * limit
