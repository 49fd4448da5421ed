"""Equal bins over an interval about zero."""

from jaxtyping import Float, Int64
from torch import Tensor


def to_bins(values: Float[Tensor, "*S"], limit: float, n_bins: int) -> Int64[Tensor, "*S"]:
    """The bin of each value, of ``n_bins`` equal ones over [-limit, limit]; outside of it, the outermost."""
    return ((values / limit + 1) * (n_bins / 2)).floor().long().clamp(0, n_bins - 1)


def from_bins(bins: Int64[Tensor, "*S"], limit: float, n_bins: int) -> Float[Tensor, "*S"]:
    """The centre of each bin, at most ``limit / n_bins`` from any value within it."""
    return ((bins + 0.5) * (2 / n_bins) - 1) * limit
