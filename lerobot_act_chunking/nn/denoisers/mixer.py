"""MLP-Mixer over the actions of a chunk: matrix products only, the fastest on a CPU."""

from typing import ClassVar

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.condition import Condition
from lerobot_act_chunking.nn.denoisers.denoiser import OUTPUT_STD, Context, Denoiser
from lerobot_act_chunking.nn.denoisers.spec import DenoiserInputs, DenoiserSpec
from lerobot_act_chunking.nn.dropout import Dropout

PARTS = 6  # shift, scale and gate of each of a block's two branches
EXPANSION = 2  # hidden width of both MLPs, in token widths and in tokens


class Mixer(Denoiser):
    """Alternates between mixing tokens and mixing channels (Tolstikhin et al. 2021), with adaLN-Zero.

    After real-time chunking's mixer (Black et al. 2025), with tokens of several actions.

    Args:
        action_dim: A.
        horizon: T.
        condition_dim: size of the condition vector.
        dim: token width D.
        n_layers: blocks.
        dropout: dropout probability in the MLPs.
        time_embedding: of width ``dim``.
        patch_size: actions per token; divides ``horizon``.

    Raises:
        ConfigurationError: it does not.
    """

    per_token_time: ClassVar[bool] = True
    adapted: ClassVar[str] = r"time_mlp\.[13]|\w+_modulation|blocks\.\d+\.(tokens|channels)\.[03]"

    def __init__(
        self,
        *,
        action_dim: int,
        horizon: int,
        condition_dim: int,
        dim: int,
        n_layers: int,
        dropout: float,
        time_embedding: nn.Module,
        patch_size: int = 1,
    ):
        super().__init__()
        if horizon % patch_size:
            raise ConfigurationError(f"horizon={horizon} must be divisible by patch_size={patch_size}")
        self.patch_size = patch_size
        n_tokens = horizon // patch_size
        self.widths = [PARTS * dim] * n_layers + [2 * dim]
        self.expand = nn.Linear(patch_size * action_dim, dim)
        self.positions = nn.Parameter(0.02 * torch.randn(n_tokens, dim))
        self.observation_mlp = nn.Sequential(
            nn.Linear(condition_dim, dim), nn.SiLU(), nn.Linear(dim, dim), nn.SiLU()
        )
        self.time_mlp = nn.Sequential(
            time_embedding, nn.Linear(dim, dim), nn.SiLU(), nn.Linear(dim, dim), nn.SiLU()
        )
        self.observation_modulation = nn.Linear(dim, sum(self.widths))
        self.time_modulation = nn.Linear(dim, sum(self.widths), bias=False)
        self.blocks = nn.ModuleList(MixerBlock(n_tokens, dim, dropout) for _ in range(n_layers))
        self.contract = nn.Linear(dim, patch_size * action_dim)
        for part in (self.observation_modulation, self.time_modulation):
            nn.init.zeros_(part.weight)
        nn.init.normal_(self.contract.weight, std=OUTPUT_STD)
        nn.init.zeros_(self.observation_modulation.bias)
        nn.init.zeros_(self.contract.bias)

    @classmethod
    def from_spec(cls, spec: DenoiserSpec, inputs: DenoiserInputs) -> "Mixer":
        """A fresh denoiser with these settings."""
        return cls(
            action_dim=inputs.action_dim,
            horizon=spec.horizon,
            condition_dim=inputs.condition_dim,
            dim=spec.dim_model,
            n_layers=spec.n_layers,
            dropout=spec.dropout,
            time_embedding=inputs.time_embedding(spec.dim_model),
            patch_size=spec.actions_per_token,
        )

    def observe(self, condition: Condition) -> Context:
        """The part of the condition vector."""
        return Context(self.observation_modulation(self.observation_mlp(condition.vector)))

    def modulate(self, time: Float[Tensor, "*S"]) -> Float[Tensor, "*S M"]:
        """The part of the time."""
        return self.time_modulation(self.time_mlp(time))

    def forward(
        self,
        x: Float[Tensor, "B T A"],
        modulation: Float[Tensor, "#B M"] | Float[Tensor, "#B N M"],
        context: Context,
    ) -> Float[Tensor, "B T A"]:
        """The answer for noisy actions; see `Denoiser`."""
        per_token = modulation if modulation.ndim == 3 else modulation[:, None]
        *blocks, last = (per_token + context.modulation[:, None]).split(self.widths, dim=-1)
        h = self.expand(x.reshape(len(x), len(self.positions), -1)) + self.positions
        for block, part in zip(self.blocks, blocks, strict=True):
            h = block(h, part)
        shift, scale = last.chunk(2, dim=-1)
        return self.contract(modulated(h, shift, scale)).reshape(x.shape)


class MixerBlock(nn.Module):
    """Mixes tokens, then channels."""

    def __init__(self, n_tokens: int, dim: int, dropout: float):
        super().__init__()
        self.tokens = _mlp(n_tokens, dropout)
        self.channels = _mlp(dim, dropout)

    def forward(self, h: Float[Tensor, "B N D"], modulation: Tensor) -> Float[Tensor, "B N D"]:
        """Refine all tokens."""
        shift, scale, gate, shift_2, scale_2, gate_2 = modulation.chunk(PARTS, dim=-1)
        h = h + gate * self.tokens(modulated(h, shift, scale).transpose(1, 2)).transpose(1, 2)
        return h + gate_2 * self.channels(modulated(h, shift_2, scale_2))


def _mlp(width: int, dropout: float) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(width, EXPANSION * width),
        nn.GELU(),
        Dropout(dropout),
        nn.Linear(EXPANSION * width, width),
    )


def modulated(
    h: Float[Tensor, "B N D"], shift: Float[Tensor, "B #N D"], scale: Float[Tensor, "B #N D"]
) -> Float[Tensor, "B N D"]:
    """Normalised tokens, scaled and shifted (adaptive layer norm, Peebles & Xie 2023)."""
    return torch.addcmul(shift, F.layer_norm(h, h.shape[-1:]), 1 + scale)
