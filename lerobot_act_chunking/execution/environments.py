"""Which environments of a batch are meant."""

from jaxtyping import Int64
from torch import Tensor

Environments = Int64[Tensor, " n"] | None  # indices; None: all of them
