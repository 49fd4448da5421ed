"""Diffusion transformer: action tokens that attend to each other and to what was observed."""

from typing import ClassVar

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.condition import Condition
from lerobot_act_chunking.nn.denoisers.denoiser import OUTPUT_STD, Context, Denoiser
from lerobot_act_chunking.nn.denoisers.mixer import modulated
from lerobot_act_chunking.nn.denoisers.spec import DenoiserInputs, DenoiserSpec
from lerobot_act_chunking.nn.dropout import Dropout

PARTS = 9  # shift, scale and gate of each of a block's three branches
Memory = tuple[Float[Tensor, "B H L d"], Float[Tensor, "B H L d"]]


class Dit(Denoiser):
    """Transformer with adaLN-Zero (Peebles & Xie 2023) and cross-attention to the observation tokens.

    Their keys and values do not change from step to step and are computed once per chunk, as pi0 caches its
    prefix (Black et al. 2024).

    Args:
        action_dim: A.
        horizon: T.
        dim: token width D, also of the observation tokens.
        n_layers: blocks.
        n_heads: attention heads; divides ``dim``.
        dropout: dropout probability in attention and MLPs.
        time_embedding: of width ``dim``.
        patch_size: actions per token; divides ``horizon``.

    Raises:
        ConfigurationError: it does not.
    """

    per_token_time: ClassVar[bool] = True
    reads_tokens: ClassVar[bool] = True
    adapted: ClassVar[str] = r"time_mlp\.[13]|\w+_modulation|blocks\.\d+\.(\w+_proj|mlp\.[03])"

    def __init__(
        self,
        *,
        action_dim: int,
        horizon: int,
        dim: int,
        n_layers: int,
        n_heads: int,
        dropout: float,
        time_embedding: nn.Module,
        patch_size: int = 1,
    ):
        super().__init__()
        if horizon % patch_size:
            raise ConfigurationError(f"horizon={horizon} must be divisible by patch_size={patch_size}")
        self.patch_size = patch_size
        self.n_heads = n_heads
        self.widths = [PARTS * dim] * n_layers + [2 * dim]
        self.expand = nn.Linear(patch_size * action_dim, dim)
        self.positions = nn.Parameter(0.02 * torch.randn(horizon // patch_size, dim))
        self.time_mlp = nn.Sequential(
            time_embedding, nn.Linear(dim, dim), nn.SiLU(), nn.Linear(dim, dim), nn.SiLU()
        )
        self.observation_mlp = nn.Sequential(nn.LayerNorm(dim), nn.Linear(dim, dim), nn.SiLU())
        self.observation_norm = nn.LayerNorm(dim)
        self.observation_modulation = nn.Linear(dim, sum(self.widths))
        self.time_modulation = nn.Linear(dim, sum(self.widths), bias=False)
        self.blocks = nn.ModuleList(DitBlock(dim, n_heads, dropout) for _ in range(n_layers))
        self.contract = nn.Linear(dim, patch_size * action_dim)
        for part in (self.observation_modulation, self.time_modulation):
            nn.init.zeros_(part.weight)
        nn.init.normal_(self.contract.weight, std=OUTPUT_STD)
        nn.init.zeros_(self.observation_modulation.bias)
        nn.init.zeros_(self.contract.bias)

    @classmethod
    def from_spec(cls, spec: DenoiserSpec, inputs: DenoiserInputs) -> "Dit":
        """A fresh denoiser with these settings."""
        return cls(
            action_dim=inputs.action_dim,
            horizon=spec.horizon,
            dim=spec.dim_model,
            n_layers=spec.n_layers,
            n_heads=spec.n_heads,
            dropout=spec.dropout,
            time_embedding=inputs.time_embedding(spec.dim_model),
            patch_size=spec.actions_per_token,
        )

    def observe(self, condition: Condition) -> Context:
        """Modulation from the mean observation token, and keys and values of all of them."""
        modulation = self.observation_modulation(self.observation_mlp(condition.tokens).mean(1))
        tokens = self.observation_norm(condition.tokens)
        return Context(modulation, tuple(block.memory(tokens) for block in self._blocks))

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
        for block, part, memory in zip(self._blocks, blocks, context.memory, strict=True):
            h = block(h, part, memory)
        shift, scale = last.chunk(2, dim=-1)
        return self.contract(modulated(h, shift, scale)).reshape(x.shape)

    @property
    def _blocks(self) -> "list[DitBlock]":
        return list(self.blocks)  # pyright: ignore[reportReturnType]


class DitBlock(nn.Module):
    """Self-attention, cross-attention to the observation, MLP; each gated, and closed at first."""

    def __init__(self, dim: int, n_heads: int, dropout: float):
        super().__init__()
        self.n_heads = n_heads
        self.dropout = dropout
        self.qkv_proj = nn.Linear(dim, 3 * dim)
        self.out_proj = nn.Linear(dim, dim)
        self.cross_q_proj = nn.Linear(dim, dim)
        self.cross_kv_proj = nn.Linear(dim, 2 * dim)
        self.cross_out_proj = nn.Linear(dim, dim)
        self.mlp = nn.Sequential(
            nn.Linear(dim, 4 * dim), nn.GELU(), Dropout(dropout), nn.Linear(4 * dim, dim)
        )

    def memory(self, tokens: Float[Tensor, "B L D"]) -> Memory:
        """Keys and values of the observation tokens."""
        keys, values = (self._heads(part) for part in self.cross_kv_proj(tokens).chunk(2, dim=-1))
        return keys, values

    def forward(
        self, h: Float[Tensor, "B N D"], modulation: Tensor, memory: Memory
    ) -> Float[Tensor, "B N D"]:
        """Refine all action tokens."""
        shifts, scales, gates = (part.chunk(3, dim=-1) for part in modulation.chunk(3, dim=-1))
        y = self.qkv_proj(modulated(h, shifts[0], scales[0]))
        q, k, v = (self._heads(part) for part in y.chunk(3, dim=-1))
        h = h + gates[0] * self.out_proj(self._attend(q, k, v))
        q = self._heads(self.cross_q_proj(modulated(h, shifts[1], scales[1])))
        h = h + gates[1] * self.cross_out_proj(self._attend(q, *memory))
        return h + gates[2] * self.mlp(modulated(h, shifts[2], scales[2]))

    def _attend(self, q: Tensor, k: Tensor, v: Tensor) -> Float[Tensor, "B N D"]:
        dropout = self.dropout if self.training else 0.0
        return F.scaled_dot_product_attention(q, k, v, dropout_p=dropout).transpose(1, 2).flatten(2)

    def _heads(self, x: Float[Tensor, "B N D"]) -> Float[Tensor, "B H N d"]:
        return x.unflatten(-1, (self.n_heads, -1)).transpose(1, 2)
