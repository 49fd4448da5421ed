"""Fixed sinusoidal positions of sequences and feature maps."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

TEMPERATURE = 10_000.0


def sequence_positions(length: int, dim: int) -> Float[Tensor, "N D"]:
    """Sine and cosine positions of a sequence ("Attention Is All You Need", section 3.5)."""
    frequency = TEMPERATURE ** (-2 * (torch.arange(dim, dtype=torch.float64) // 2) / dim)
    angle = torch.arange(length, dtype=torch.float64)[:, None] * frequency
    return _interleaved(angle).float()


def image_positions(height: int, width: int, dim: int) -> Float[Tensor, "N D"]:
    """Positions of a feature map's cells, row by row: half the channels for y, half for x (DETR).

    Coordinates are normalised to (0, 2 pi]; they start at one cell, not zero, as in ACT.

    Args:
        height: rows of the feature map.
        width: columns of the feature map.
        dim: token width, a multiple of 4.
    """
    half = dim // 2
    period = TEMPERATURE ** (2 * (torch.arange(half, dtype=torch.float32) // 2) / half)
    y, x = (
        _interleaved(torch.arange(1, n + 1)[:, None] / (n + 1e-6) * (2 * math.pi) / period)
        for n in (height, width)
    )
    grid = torch.cat((y[:, None].expand(-1, width, -1), x[None].expand(height, -1, -1)), dim=-1)
    return grid.flatten(0, 1)


class ImagePositions(nn.Module):
    """`image_positions`, kept per feature-map size so that a training step does not recompute them."""

    def __init__(self, dim: int):
        super().__init__()
        self.dim = dim
        self._kept: dict[tuple[int, int, torch.device, torch.dtype], Tensor] = {}

    def forward(self, height: int, width: int, like: Tensor) -> Float[Tensor, "N D"]:
        """Positions of a feature map's cells, in the type and on the device of ``like``."""
        place = (height, width, like.device, like.dtype)
        if place not in self._kept:
            with torch.inference_mode(False):  # kept for training too, whichever mode comes first
                self._kept[place] = image_positions(height, width, self.dim).to(like)
        return self._kept[place]


def _interleaved(angle: Float[Tensor, "N D"]) -> Float[Tensor, "N D"]:
    return torch.stack((angle[:, 0::2].sin(), angle[:, 1::2].cos()), dim=-1).flatten(1)
