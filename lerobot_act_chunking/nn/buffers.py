"""Buffers: of checkpoints that were saved before there were any, and of numbers that the CPU reads."""

from collections.abc import Callable
from typing import Any, ClassVar

from torch import Tensor, nn


def keep_missing_buffers(module: nn.Module, state_dict: dict[str, Tensor], prefix: str, *_: Any) -> None:
    """Leave buffers that a state dict does not hold as they are, in place of refusing it.

    For ``register_load_state_dict_pre_hook``.
    """
    for name, buffer in module.named_buffers():
        state_dict.setdefault(prefix + name, buffer)


class CountsOnCpu(nn.Module):
    """Keeps some of its own buffers on the CPU, wherever it is moved.

    Reading a number that is on another device waits until all is done that this device was given.

    Attributes:
        counts: names of these buffers.
    """

    counts: ClassVar[tuple[str, ...]]

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> "CountsOnCpu":
        kept = {name: self._buffers[name] for name in self.counts}
        super()._apply(fn, recurse)
        self._buffers.update(kept)
        return self
