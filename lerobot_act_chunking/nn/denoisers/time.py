"""Embeddings of the noise level that a denoiser works at."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn


class StepEmbedding(nn.Module):
    """Sine and cosine of integer diffusion steps, as in Diffusion Policy and LeRobot.

    Args:
        dim: width, even.
    """

    def __init__(self, dim: int):
        super().__init__()
        half = dim // 2
        self.frequencies: Tensor
        frequencies = torch.exp(torch.arange(half) * -(math.log(10_000) / (half - 1)))
        self.register_buffer("frequencies", frequencies, persistent=False)

    def forward(self, time: Float[Tensor, "*S"]) -> Float[Tensor, "*S D"]:
        """Embedding of each step."""
        angle = time[..., None] * self.frequencies
        return torch.cat((angle.sin(), angle.cos()), dim=-1)


class UnitTimeEmbedding(nn.Module):
    """Sine and cosine of times in [0, 1], with periods 0.004 ... 4 in equal ratios (pi0, Black et al. 2024).

    Args:
        dim: width, even.
    """

    def __init__(self, dim: int):
        super().__init__()
        periods = torch.logspace(math.log10(4e-3), math.log10(4.0), dim // 2)
        self.frequencies: Tensor
        self.register_buffer("frequencies", 2 * math.pi / periods, persistent=False)

    def forward(self, time: Float[Tensor, "*S"]) -> Float[Tensor, "*S D"]:
        """Embedding of each time."""
        angle = time[..., None] * self.frequencies
        return torch.cat((angle.sin(), angle.cos()), dim=-1)
