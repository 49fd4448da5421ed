"""Dropout that does not dominate a small policy's training step on a CPU."""

from typing import Any

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Bool, Float
from torch import Tensor, nn

LEVELS = 2**16


class Dropout(nn.Module):
    """Dropout whose CPU masks come from 16 random bits per element.

    PyTorch draws one Bernoulli sample per element, which takes a fifth of a small policy's training step;
    bits are over twice as fast. The probability is resolved to 1/65536. Other devices use PyTorch's kernel.
    """

    def __init__(self, p: float):
        super().__init__()
        self.p = p

    def forward(self, x: Float[Tensor, "*S"]) -> Float[Tensor, "*S"]:
        """Zero elements with probability ``p`` and scale the rest by 1 / (1 - p), when training."""
        if not self.training or self.p == 0 or x.device.type != "cpu":
            return F.dropout(x, self.p, self.training)
        return x * keep_mask(x.shape, self.p).to(x.dtype).mul_(1 / (1 - self.p))


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


def keep_mask(shape: torch.Size, p: float) -> Bool[Tensor, "*S"]:
    """Elements to keep; each is dropped with probability ``p``. Drawn from PyTorch's CPU generator."""
    n = shape.numel()
    bits = torch.empty(-(-n // 4), dtype=torch.int64).random_(-(2**63), None)
    return (bits.view(torch.int16)[:n] >= round(p * LEVELS) - LEVELS // 2).view(shape)
