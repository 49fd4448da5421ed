"""Choosing among sampled chunks."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

DISCOUNT = 0.5  # per step, as in the authors' code


def most_coherent(
    samples: Float[Tensor, "N n T A"], plan: Float[Tensor, "n P A"], covered: Bool[Tensor, "r P"]
) -> Float[Tensor, "n T A"]:
    """The sample of each environment that continues its current plan best.

    This is the backward coherence of Bidirectional Decoding (Liu et al. 2024, eq. 4): the discounted sum of
    distances over the steps that both cover, near steps counting most. With none it is the first sample.

    Args:
        samples: N chunks for each of n environments.
        plan: the current plan of each from this step on.
        covered: which of the plan's steps count; one row for all environments, or one for each.
    """
    n_common = min(samples.shape[2], plan.shape[1])
    distance = (samples[:, :, :n_common] - plan[:, :n_common]).norm(dim=-1)
    discount = DISCOUNT ** torch.arange(n_common, device=samples.device)
    weight = covered[:, :n_common].to(distance) * discount
    best = (distance * weight).sum(-1).argmin(0)  # (n,)
    return samples[best, torch.arange(len(best), device=samples.device)]
