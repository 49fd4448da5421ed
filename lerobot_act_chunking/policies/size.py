"""How many weights a network may have."""

from collections.abc import Callable
from contextlib import suppress

import torch
from torch import nn

from lerobot_act_chunking.errors import ConfigurationError

MOST_WEIGHTS = 4 * 10**9  # 64 GB with their gradients and AdamW's two moments: a large card


def check_size(build: Callable[[], nn.Module]) -> None:
    """Count the weights without memory for them, and refuse what no single device trains.

    Raises:
        ConfigurationError: naming their number and the limit.
    """
    n_weights = 0  # unknown: some backbones of timm compute with numbers while they are built
    with suppress(RuntimeError, NotImplementedError), torch.device("meta"):
        n_weights = sum(each.numel() for each in build().parameters())
    if n_weights > MOST_WEIGHTS:
        raise ConfigurationError(
            f"the network would have {n_weights / 1e9:.1f} billion weights, more than "
            f"{MOST_WEIGHTS / 1e9:.0f} billion: set its widths or its layers to less"
        )
