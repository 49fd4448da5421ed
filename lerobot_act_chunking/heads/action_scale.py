"""Scales of action distributions that stay between bounds."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

MAX_SCALE = math.exp(2.0)  # normalised actions are within a few units
RESOLUTION = 2.0**-24  # of uniform numbers in single precision


class BoundedScale(nn.Module):
    """The logarithm of a scale as a smooth function of any number, with 0 for a scale of 1.

    A sigmoid between the logarithms of the bounds: unlike a clamp it has a gradient everywhere.

    Args:
        minimum: least scale, above 0 and below 1; the largest is e^2.
    """

    def __init__(self, minimum: float):
        super().__init__()
        self.low, self.high = math.log(minimum), math.log(MAX_SCALE)
        self.offset = math.log(-self.low / self.high)  # sigmoid(offset) is where a logarithm of 0 lies

    def log(self, raw: Float[Tensor, "*S"]) -> Float[Tensor, "*S"]:
        """Logarithms of the scales."""
        return self.low + (self.high - self.low) * torch.sigmoid(raw + self.offset)


def open_interval(draws: Float[Tensor, "*S"]) -> Float[Tensor, "*S"]:
    """Uniform numbers in [0, 1) kept off both ends, where inverse distribution functions are infinite."""
    return draws.clamp(RESOLUTION / 2, 1 - RESOLUTION)
