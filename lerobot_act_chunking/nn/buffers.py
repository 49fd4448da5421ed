"""Buffers of checkpoints that were saved before there were any."""

from typing import Any

from torch import Tensor, nn


def keep_missing_buffers(module: nn.Module, state_dict: dict[str, Tensor], prefix: str, *_: Any) -> None:
    """Leave buffers that a state dict does not hold as they are, in place of refusing it.

    For ``register_load_state_dict_pre_hook``.
    """
    for name, buffer in module.named_buffers():
        state_dict.setdefault(prefix + name, buffer)
