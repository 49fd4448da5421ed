"""ReLU and dropout in one pass."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.nn.dropout import Dropout, keep_mask


class ReluDropout(Dropout):
    """Dropout of rectified units: one pass each way, in the memory of its input.

    A wide hidden layer is the largest tensor of a transformer's training step, and every new copy of it costs
    a CPU more than the arithmetic on it. What gets through is positive, so the result says where a gradient
    goes back, and no mask is kept. The input, which must be a tensor that nothing else reads, is overwritten.
    """

    def forward(self, x: Float[Tensor, "*S"]) -> Float[Tensor, "*S"]:
        """Rectify, zero units with probability ``p`` and scale the rest by 1 / (1 - p), when training."""
        if not self.training or self.p == 0 or x.device.type != "cpu" or torch.compiler.is_compiling():
            return super().forward(x.relu_())
        return _KeepSome.apply(x, keep_mask(x.shape, self.p), 1 / (1 - self.p))


class _KeepSome(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, keep: Tensor, scale: float) -> Tensor:
        ctx.scale = scale
        ctx.mark_dirty(x)
        x.relu_().mul_(scale).masked_fill_(~keep, 0)
        ctx.save_for_backward(x)
        return x

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:  # pyright: ignore[reportIncompatibleMethodOverride]
        (y,) = ctx.saved_tensors
        return torch.ops.aten.threshold_backward(gradient, y, 0).mul_(ctx.scale), None, None
