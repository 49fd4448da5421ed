"""Diffusion Policy's U-Net over time, with everything that does not change between steps computed once."""

from collections.abc import Sequence
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.condition import Condition
from lerobot_act_chunking.nn.denoisers.denoiser import Context, Denoiser
from lerobot_act_chunking.nn.denoisers.short_conv import ShortConv1d
from lerobot_act_chunking.nn.denoisers.spec import DenoiserInputs, DenoiserSpec

SIZES = {"S": (64, 128, 256), "M": (128, 256, 512), "L": (256, 512, 1024), "XL": (512, 1024, 2048)}
"""Channels by name; XL is LeRobot's."""


class Unet1d(Denoiser):
    """Convolutions over the chunk, halving its length and restoring it, modulated by FiLM (Chi et al. 2023).

    The blocks are those of LeRobot's `diffusion`, whose weights fit (tests/parity). There each block applies
    ``Linear(Mish([time, observation]))`` in every step. That is a sum, ``W_t Mish(time) + W_o
    Mish(observation) + b``: here one matrix for all blocks gives the second part once per chunk, and another
    the first for all steps at once.

    Args:
        action_dim: A.
        condition_dim: size of the condition vector.
        time_embedding: of width ``time_dim``.
        time_dim: width of the time embedding.
        down_dims: channels of each level; the chunk's length must be divisible by 2 per level but the first.
        kernel_size: of the convolutions, odd.
        n_groups: of the group normalisation.
        film_scale: let FiLM scale, not only shift.
    """

    adapted: ClassVar[str] = r"time_mlp\.[13]|\w+_film|((down|up)\.\d+|middle)\.\w+\.conv[12]\.0"

    def __init__(
        self,
        *,
        action_dim: int,
        condition_dim: int,
        time_embedding: nn.Module,
        time_dim: int,
        down_dims: Sequence[int],
        kernel_size: int,
        n_groups: int,
        film_scale: bool,
    ):
        super().__init__()
        self.time_mlp = nn.Sequential(
            time_embedding, nn.Linear(time_dim, 4 * time_dim), nn.Mish(), nn.Linear(4 * time_dim, time_dim)
        )

        def block(n_in: int, n_out: int) -> ResidualBlock1d:
            return ResidualBlock1d(n_in, n_out, kernel_size, n_groups, film_scale)

        pairs = list(zip((action_dim, *down_dims[:-1]), down_dims, strict=True))
        self.down = nn.ModuleList(Level(block(a, b), block(b, b)) for a, b in pairs)
        self.middle = Level(block(down_dims[-1], down_dims[-1]), block(down_dims[-1], down_dims[-1]))
        self.up = nn.ModuleList(Level(block(2 * b, a), block(a, a)) for a, b in reversed(pairs[1:]))
        self.downsample = nn.ModuleList(ShortConv1d(b, b, 3, 2, 1) for b in down_dims[:-1])
        self.upsample = nn.ModuleList(nn.ConvTranspose1d(a, a, 4, 2, 1) for a, _ in reversed(pairs[1:]))
        self.final = ConvBlock1d(down_dims[0], down_dims[0], kernel_size, 8)
        self.contract = nn.Conv1d(down_dims[0], action_dim, 1)
        self._widths = [each.film_width for level in self._levels for each in (level.first, level.second)]
        self.activation = nn.Mish()
        self.observation_film = nn.Linear(condition_dim, sum(self._widths))
        self.time_film = nn.Linear(time_dim, sum(self._widths), bias=False)

    @classmethod
    def from_spec(cls, spec: DenoiserSpec, inputs: DenoiserInputs) -> "Unet1d":
        """A fresh denoiser with these settings."""
        return cls(
            action_dim=inputs.action_dim,
            condition_dim=inputs.condition_dim,
            time_embedding=inputs.time_embedding(spec.diffusion_step_embed_dim),
            time_dim=spec.diffusion_step_embed_dim,
            down_dims=spec.down_dims,
            kernel_size=spec.kernel_size,
            n_groups=spec.n_groups,
            film_scale=spec.use_film_scale_modulation,
        )

    @property
    def _levels(self) -> "list[Level]":
        return [*self.down, self.middle, *self.up]  # pyright: ignore[reportReturnType]

    def observe(self, condition: Condition) -> Context:
        """FiLM's part of the condition vector."""
        return Context(self.observation_film(self.activation(condition.vector)))

    def modulate(self, time: Float[Tensor, "*S"]) -> Float[Tensor, "*S M"]:
        """FiLM's part of the time."""
        return self.time_film(self.activation(self.time_mlp(time)))

    def forward(
        self, x: Float[Tensor, "B T A"], modulation: Float[Tensor, "#B M"], context: Context
    ) -> Float[Tensor, "B T A"]:
        """The answer for noisy actions; see `Denoiser`.

        Raises:
            ConfigurationError: the chunk's length cannot be halved as often as there are levels.
        """
        factor = 2 ** len(self.downsample)
        if x.shape[1] % factor:
            below = x.shape[1] // factor * factor
            raise ConfigurationError(
                f"horizon={x.shape[1]} must be a multiple of {factor}, which this unet1d divides it by: "
                f"{below} or {below + factor}"
            )
        films = iter((modulation + context.modulation)[..., None].split(self._widths, dim=1))
        h, skipped = x.transpose(1, 2), []
        for i, level in enumerate(self.down):
            h = level(h, next(films), next(films))
            skipped.append(h)
            h = self.downsample[i](h) if i < len(self.downsample) else h
        h = self.middle(h, next(films), next(films))
        for level, upsample in zip(self.up, self.upsample, strict=True):
            h = upsample(level(torch.cat((h, skipped.pop()), dim=1), next(films), next(films)))
        return self.contract(self.final(h)).transpose(1, 2)


class Level(nn.Module):
    """Two residual blocks at one resolution."""

    def __init__(self, first: "ResidualBlock1d", second: "ResidualBlock1d"):
        super().__init__()
        self.first = first
        self.second = second

    def forward(self, h: Float[Tensor, "B C L"], film: Tensor, film_2: Tensor) -> Float[Tensor, "B D L"]:
        """Both blocks, each with its own modulation."""
        return self.second(self.first(h, film), film_2)


class ConvBlock1d(nn.Sequential):
    """Convolution, group normalisation, Mish."""

    def __init__(self, n_in: int, n_out: int, kernel_size: int, n_groups: int):
        super().__init__(
            ShortConv1d(n_in, n_out, kernel_size, padding=kernel_size // 2),
            nn.GroupNorm(n_groups, n_out),
            nn.Mish(),
        )


class ResidualBlock1d(nn.Module):
    """Two convolutions with FiLM (Perez et al. 2018) between them, and a skip connection."""

    def __init__(self, n_in: int, n_out: int, kernel_size: int, n_groups: int, film_scale: bool):
        super().__init__()
        self.film_scale = film_scale
        self.film_width = 2 * n_out if film_scale else n_out
        self.conv1 = ConvBlock1d(n_in, n_out, kernel_size, n_groups)
        self.conv2 = ConvBlock1d(n_out, n_out, kernel_size, n_groups)
        self.skip = nn.Conv1d(n_in, n_out, 1) if n_in != n_out else nn.Identity()

    def forward(self, h: Float[Tensor, "B C L"], film: Float[Tensor, "B M 1"]) -> Float[Tensor, "B D L"]:
        """Refine ``h``; ``film`` holds scales (if any), then shifts, of each channel."""
        y = self.conv1(h)
        if self.film_scale:
            scale, shift = film.chunk(2, dim=1)
            y = torch.addcmul(shift, y, scale)
        else:
            y = y + film
        return self.conv2(y) + self.skip(h)
