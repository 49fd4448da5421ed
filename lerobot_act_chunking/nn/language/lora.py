"""Low-rank adaptation (Hu et al. 2021) of an encoder's body."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.cpu.linear import Linear

RANK = 16


class LoraLinear(Linear):
    """A linear layer whose weights stay, and which learns a product of two thin matrices beside them.

    Args:
        layer: whose weights it takes over, under the same names; it begins as this layer.
    """

    def __init__(self, layer: nn.Linear):
        super().__init__(layer.in_features, layer.out_features, bias=layer.bias is not None)
        self.weight, self.bias = layer.weight, layer.bias
        rank = min(RANK, layer.in_features, layer.out_features)
        self.down = nn.Parameter(torch.randn(rank, layer.in_features) / math.sqrt(layer.in_features))
        self.up = nn.Parameter(torch.zeros(layer.out_features, rank))

    def forward(  # pyright: ignore[reportIncompatibleMethodOverride]  (PyTorch calls it input)
        self, x: Float[Tensor, "*N I"]
    ) -> Float[Tensor, "*N O"]:
        """The layer's output and that of the two matrices."""
        return super().forward(x) + x @ self.down.t() @ self.up.t()


def adapt(body: nn.Module) -> None:
    """Replace every linear layer of ``body`` by an adapted one."""
    for parent in list(body.modules()):
        for name, child in list(parent.named_children()):
            if isinstance(child, nn.Linear) and not isinstance(child, LoraLinear):
                setattr(parent, name, LoraLinear(child))
