"""Linear layers that are not slow for a few rows on a CPU."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

_MANY_ROWS = 8
_LARGE = 2**17  # a smaller weight stays in the processor's cache


class Linear(nn.Linear):
    """``nn.Linear`` whose product has the weight in front when there are a few rows only.

    A robot that asks for a chunk from a few state vectors has an encoder over a few tokens, in which reading
    the weights is most of the work. ``weight @ x.T`` reads a square or a tall weight about twice as fast as
    ``x @ weight.T`` does, and with every thread; a flat weight it reads more slowly.
    """

    def forward(  # pyright: ignore[reportIncompatibleMethodOverride]  (PyTorch calls it input)
        self, x: Float[Tensor, "*N I"]
    ) -> Float[Tensor, "*N O"]:
        """``x @ weight.T + bias``."""
        n_rows = x.shape[:-1].numel()
        tall = self.out_features >= self.in_features and self.weight.numel() > _LARGE
        if not (tall and 1 < n_rows < _MANY_ROWS) or x.device.type != "cpu" or torch.compiler.is_compiling():
            return super().forward(x)
        y = (self.weight @ x.reshape(n_rows, -1).t()).t().contiguous().view(*x.shape[:-1], -1)
        return y if self.bias is None else y + self.bias


def is_plain(*modules: nn.Module) -> bool:
    """Whether these are linear layers and nothing else, such as one that LoRA has wrapped.

    Only then may ``weight`` be used in place of a call.
    """
    return all(type(module) in (Linear, nn.Linear) for module in modules)
