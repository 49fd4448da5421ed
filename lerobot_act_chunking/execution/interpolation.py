"""From predictions every few control steps to one action per control step."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor


def upsample(
    keyframes: Float[Tensor, "B N A"], stride: int, gripper_dims: Sequence[int] = ()
) -> Float[Tensor, "B T A"]:
    """Actions at every control step from actions at every ``stride``-th, T = (N - 1) * stride + 1.

    Piecewise cubic Hermite interpolation that keeps monotone data monotone (PCHIP; Fritsch and Carlson 1980,
    with the derivatives of Fritsch and Butland 1984): no overshoot between key frames, which it passes
    through. The same numbers as SciPy's `PchipInterpolator`, on any device and differentiable.

    Args:
        keyframes: N actions, ``stride`` control steps apart.
        stride: control steps between them.
        gripper_dims: dimensions that hold each key frame's value instead.
    """
    if stride == 1 or keyframes.shape[1] == 1:
        return keyframes
    steps = keyframes[:, 1:] - keyframes[:, :-1]
    slopes = _slopes(steps)
    u = torch.arange(stride, dtype=keyframes.dtype, device=keyframes.device)[:, None] / stride
    start, left, right = keyframes[:, :-1, None], slopes[:, :-1, None], slopes[:, 1:, None]
    rise = (3 - 2 * u) * u**2 * steps[:, :, None]
    dense = start + rise + u * (1 - u) ** 2 * left - u**2 * (1 - u) * right  # (B, N - 1, stride, A)
    held = list(gripper_dims)
    dense[..., held] = start.expand_as(dense)[..., held]
    return torch.cat([dense.flatten(1, 2), keyframes[:, -1:]], dim=1)


def _slopes(steps: Float[Tensor, "B M A"]) -> Float[Tensor, "B N A"]:
    """Derivative at each of the M + 1 key frames, per key-frame interval."""
    if steps.shape[1] == 1:
        return steps.expand(-1, 2, -1)
    before, after = steps[:, :-1], steps[:, 1:]
    monotone = before * after > 0
    total = torch.where(monotone, before + after, 1)
    inner = torch.where(monotone, 2 * before * after / total, 0)  # harmonic mean
    return torch.cat(
        [_end_slope(steps[:, :1], steps[:, 1:2]), inner, _end_slope(steps[:, -1:], steps[:, -2:-1])], dim=1
    )


def _end_slope(outer: Float[Tensor, "B 1 A"], inner: Float[Tensor, "B 1 A"]) -> Float[Tensor, "B 1 A"]:
    """One-sided three-point derivative, limited so that the end interval stays monotone."""
    slope = (3 * outer - inner) / 2
    slope = torch.where(slope * outer <= 0, 0, slope)
    turns = (outer * inner < 0) & (slope.abs() > 3 * outer.abs())
    return torch.where(turns, 3 * outer, slope)
