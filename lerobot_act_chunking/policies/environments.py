"""Environments of a batch, as callers name them."""

from collections.abc import Sequence

import torch
from torch import Tensor


def indices(envs: Sequence[int] | Tensor) -> Tensor:
    """Environments, given as indices or as a mask over all, as indices on the CPU."""
    envs = torch.as_tensor(envs, device="cpu")
    return envs.nonzero()[:, 0] if envs.dtype == torch.bool else envs.to(torch.int64)
