"""Is the latent in use? Numbers cheap enough for every training step."""

from jaxtyping import Float
from torch import Tensor

ACTIVE_NATS = 0.01
ACTIVE_VARIANCE = 0.01


def latent_metrics(mean: Float[Tensor, "B L"], divergence: Float[Tensor, "B J"]) -> dict[str, Tensor]:
    """How much a batch's posteriors say about their demonstrations.

    Returns:
        ``kl_max``, largest divergence of a dimension [nats]; ``kl_active_dims``, how many are above
        `ACTIVE_NATS`; ``active_units``, dimensions whose posterior mean differs between demonstrations, by
        a variance above `ACTIVE_VARIANCE` (Burda et al. 2016, section 5.2).
    """
    by_dimension = divergence.detach().mean(0)
    active = mean.detach().var(0, correction=0) > ACTIVE_VARIANCE
    values = (by_dimension.max(), (by_dimension > ACTIVE_NATS).sum(), active.sum())
    names = ("kl_max", "kl_active_dims", "active_units")
    return {name: value.float() for name, value in zip(names, values, strict=True)}
