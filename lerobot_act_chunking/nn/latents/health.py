"""Is the latent in use? Numbers cheap enough for every training step."""

from jaxtyping import Float
from torch import Tensor

ACTIVE_NATS = 0.01
ACTIVE_VARIANCE = 0.01


def latent_metrics(
    mean: Float[Tensor, "B L"], divergence: Float[Tensor, "B J"]
) -> dict[str, Float[Tensor, ""]]:
    """How much a batch's posteriors say about their demonstrations, as scalars yet to be read.

    Returns:
        ``kl_max``, largest divergence of a dimension [nats]; ``kl_active_dims``, how many are above
        `ACTIVE_NATS`; ``active_units``, dimensions whose posterior mean differs between demonstrations, by
        a variance above `ACTIVE_VARIANCE` (Burda et al. 2016, section 5.2).
    """
    by_dimension = divergence.detach().mean(0)
    variance = mean.detach().var(0, correction=0)
    return {
        "kl_max": by_dimension.max(),
        "kl_active_dims": (by_dimension > ACTIVE_NATS).sum().to(mean.dtype),
        "active_units": (variance > ACTIVE_VARIANCE).sum().to(mean.dtype),
    }
