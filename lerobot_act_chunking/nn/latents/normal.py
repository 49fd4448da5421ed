"""Diagonal normal distributions, given by mean and log-variance."""

import math

import torch
from jaxtyping import Float
from torch import Tensor


def sample_normal(
    mean: Float[Tensor, "*B L"], log_variance: Float[Tensor, "*B L"], noise: Float[Tensor, "*B L"]
) -> Float[Tensor, "*B L"]:
    """Reparametrised sample (Kingma & Welling 2014, section 2.4) from standard normal ``noise``."""
    return mean + (log_variance / 2).exp() * noise


def kl_to_standard_normal(
    mean: Float[Tensor, "*B L"], log_variance: Float[Tensor, "*B L"]
) -> Float[Tensor, "*B L"]:
    """KL(q || N(0, I)) of each dimension [nats] (Kingma & Welling 2014, appendix B)."""
    return -0.5 * (1 + log_variance - mean.square() - log_variance.exp())


def kl_between_normals(
    mean: Float[Tensor, "*B L"],
    log_variance: Float[Tensor, "*B L"],
    other_mean: Float[Tensor, "*B L"],
    other_log_variance: Float[Tensor, "*B L"],
) -> Float[Tensor, "*B L"]:
    """KL(q || other) of each dimension [nats]: that to N(0, I), in units of the other distribution."""
    distance = (mean - other_mean) * (-other_log_variance / 2).exp()
    return kl_to_standard_normal(distance, log_variance - other_log_variance)


def log_density(
    x: Float[Tensor, "*#B L"], mean: Float[Tensor, "*#B L"], log_variance: Float[Tensor, "*#B L"]
) -> Float[Tensor, "*B"]:
    """Logarithm of the density at ``x`` [nats]."""
    squared = (x - mean).square() * (-log_variance).exp()
    return -0.5 * (squared + log_variance + math.log(2 * math.pi)).sum(-1)


def select_component(
    weights: Float[Tensor, "#B M"] | Float[Tensor, " M"], noise: Float[Tensor, " B"]
) -> Float[Tensor, "B M"]:
    """One-hot choices with these probabilities, from one standard normal number each (inverse CDF).

    Choices without weight are never made, also not by rounding.
    """
    uniform = torch.special.ndtr(noise)[:, None]
    below = weights.cumsum(-1) / weights.sum(-1, keepdim=True)
    reached = (uniform >= below).sum(-1).clamp_max(last_with_weight(weights))
    return torch.nn.functional.one_hot(reached, weights.shape[-1]).to(weights.dtype)


def last_with_weight(weights: Float[Tensor, "*B M"]) -> Tensor:
    """Index of the last choice whose weight is above zero."""
    places = torch.arange(weights.shape[-1], device=weights.device)
    return torch.where(weights > 0, places, 0).amax(-1)
