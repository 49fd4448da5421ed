"""The noise that a policy draws while it acts."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch

_APART = 1_000_003
"""Between the seeds of two draws: more than there are episodes."""


@contextmanager
def drawing(policy: Any, draw: int, seed: int) -> Iterator[None]:
    """Let a policy draw the noise of this repetition.

    Policies of this package draw for every episode by its own seed. Others draw from PyTorch's generator,
    which begins anew with every group.
    """
    config = getattr(policy, "inner", policy).config
    own = getattr(config, "noise_seed", None)
    before = torch.random.get_rng_state()
    torch.manual_seed(seed + draw * _APART)
    if own is not None:
        config.noise_seed = own + draw * _APART
    try:
        yield
    finally:
        torch.random.set_rng_state(before)
        if own is not None:
            config.noise_seed = own
