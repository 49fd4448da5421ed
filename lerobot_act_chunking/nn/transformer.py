"""Transformer encoder and DETR-style decoder, in both norm orders.

Positions are added to queries and keys of every layer, never to values (DETR, Carion et al. 2020).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Bool, Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.attention import Attention
from lerobot_act_chunking.nn.dropout import Dropout, ReluDropout
from lerobot_act_chunking.nn.linear import Linear, is_plain
from lerobot_act_chunking.nn.span import Span

Activation = Literal["relu", "gelu"]


@dataclass(frozen=True)
class LayerSpec:
    """The sizes all layers of one network share.

    Attributes:
        dim: token width.
        n_heads: attention heads; divides ``dim``.
        dim_feedforward: hidden width of the feed-forward branch.
        dropout: probability, on attention weights, hidden units and every residual branch.
        activation: of the feed-forward branch.
        pre_norm: normalise before each branch (stable at high learning rates) instead of after it (as ACT).
    """

    dim: int
    n_heads: int
    dim_feedforward: int
    dropout: float
    activation: Activation
    pre_norm: bool


class Residual(nn.Module):
    """A branch with its skip connection, dropout and norm: the one place that knows both norm orders."""

    def __init__(self, spec: LayerSpec):
        super().__init__()
        self.pre_norm = spec.pre_norm
        self.norm = nn.LayerNorm(spec.dim)
        self.dropout = Dropout(spec.dropout)

    def add(self, x: Float[Tensor, "#B #N D"], branch: Callable[[Tensor], Tensor]) -> Float[Tensor, "B M D"]:
        """Add ``branch(x)`` to ``x``. A branch that returns only the first M tokens drops the others."""
        y = self.dropout(branch(self.norm(x) if self.pre_norm else x))
        y = x[:, : y.shape[1]] + y
        return y if self.pre_norm else self.norm(y)


class SelfAttention(Residual):
    """Tokens attend to each other."""

    def __init__(self, spec: LayerSpec):
        super().__init__(spec)
        self.attention = Attention(spec.dim, spec.n_heads, spec.dropout)

    def forward(
        self,
        x: Float[Tensor, "#B #N D"] | Span,
        positions: Float[Tensor, "N D"],
        is_pad: Bool[Tensor, "#B N"] | None = None,
        n_out: int | None = None,
        *,
        causal: bool = False,
    ) -> Float[Tensor, "B M D"]:
        """Mix all tokens into the first ``n_out`` (all by default); the others only serve as keys.

        ``causal`` tokens see themselves and those before them.
        """
        if isinstance(x, Span):
            span, x = x, x.tokens()
            attention = self.attention
            plain = is_plain(attention.q_proj, attention.k_proj, attention.v_proj)
            if plain and not (self.pre_norm or n_out or causal):
                return self.add(x, lambda _: attention.attend_span(span, positions, is_pad))

        def mix(y: Tensor) -> Tensor:
            placed = y + positions
            return self.attention(placed[:, :n_out], placed, y, is_pad, causal=causal)

        return self.add(x, mix)


class CrossAttention(Residual):
    """Queries attend to a memory."""

    def __init__(self, spec: LayerSpec):
        super().__init__(spec)
        self.attention = Attention(spec.dim, spec.n_heads, spec.dropout)

    def forward(
        self,
        x: Float[Tensor, "#B #Q D"],
        positions: Float[Tensor, "Q D"],
        memory_keys: Float[Tensor, "B N D"],
        memory: Float[Tensor, "B N D"],
    ) -> Float[Tensor, "B Q D"] | Span:
        """Add to each query what it finds in ``memory``; ``memory_keys`` is ``memory`` with its positions.

        Queries of the same content that find little stay in the span of that.
        """
        same = x.shape[:2] == (1, 1) and not self.pre_norm and not (self.training and self.dropout.p)
        if same and self.attention.factored_is_cheaper(len(positions), memory.shape[1]):
            found = self.attention.attend_factored(
                x + positions, *self.attention.project_keys_values(memory_keys, memory)
            )
            start = (x + self.attention.out_proj.bias).expand(len(memory), -1, -1)
            sums = Span(F.pad(found.weights, (0, 1), value=1.0), torch.cat((found.vectors, start), dim=1))
            return sums.normalized(self.norm)
        return self.add(x, lambda y: self.attention(y + positions, memory_keys, memory))


class FeedForward(Residual):
    """Two linear layers on every token, with an activation between them."""

    def __init__(self, spec: LayerSpec):
        super().__init__(spec)
        self.expand = Linear(spec.dim, spec.dim_feedforward)
        self.activation = (
            ReluDropout(spec.dropout)
            if spec.activation == "relu"
            else nn.Sequential(nn.GELU(), Dropout(spec.dropout))
        )
        self.contract = Linear(spec.dim_feedforward, spec.dim)

    def forward(self, x: Float[Tensor, "B N D"] | Span) -> Float[Tensor, "B N D"]:
        """Refine every token on its own."""
        if isinstance(x, Span):
            span, x = x, x.tokens()
            if is_plain(self.expand) and not self.pre_norm:
                return self.add(x, lambda _: self.contract(self.activation(span.through(self.expand))))
        return self.add(x, lambda y: self.contract(self.activation(self.expand(y))))


class EncoderLayer(nn.Module):
    """Self-attention, then feed-forward."""

    def __init__(self, spec: LayerSpec):
        super().__init__()
        self.mix = SelfAttention(spec)
        self.refine = FeedForward(spec)

    def forward(
        self,
        x: Float[Tensor, "B N D"] | Span,
        positions: Float[Tensor, "N D"],
        is_pad: Bool[Tensor, "B N"] | None = None,
        n_out: int | None = None,
    ) -> Float[Tensor, "B M D"]:
        """Encode the first ``n_out`` tokens (all by default), which see all others."""
        return self.refine(self.mix(x, positions, is_pad, n_out))


class Encoder(nn.Module):
    """A stack of encoder layers, with a last norm in pre-norm order."""

    def __init__(self, spec: LayerSpec, n_layers: int):
        super().__init__()
        self.layers = nn.ModuleList(EncoderLayer(spec) for _ in range(n_layers))
        self.norm = nn.LayerNorm(spec.dim) if spec.pre_norm else nn.Identity()
        init_like_act(self)

    def forward(
        self,
        x: Float[Tensor, "B N D"] | Span,
        positions: Float[Tensor, "N D"],
        is_pad: Bool[Tensor, "B N"] | None = None,
        n_out: int | None = None,
    ) -> Float[Tensor, "B M D"]:
        """Encode all tokens, or the first ``n_out``: the same values, but the last layer skips the others."""
        *body, last = self.layers
        for layer in body:
            x = layer(x, positions, is_pad)
        return self.norm(last(x, positions, is_pad, n_out))


class DecoderLayer(nn.Module):
    """Self-attention of queries (not in the first layer, see `Decoder`), cross-attention, feed-forward."""

    def __init__(self, spec: LayerSpec, *, queries_interact: bool):
        super().__init__()
        self.mix = SelfAttention(spec) if queries_interact else None
        self.read = CrossAttention(spec)
        self.refine = FeedForward(spec)

    def forward(
        self,
        x: Float[Tensor, "#B #Q D"],
        positions: Float[Tensor, "Q D"],
        memory_keys: Float[Tensor, "B N D"],
        memory: Float[Tensor, "B N D"],
        *,
        causal: bool = False,
    ) -> Float[Tensor, "B Q D"]:
        """Refine queries ``x`` with what they find in ``memory``; ``causal`` ones do not see later ones."""
        if self.mix is not None:
            x = self.mix(x, positions, causal=causal)
        return self.refine(self.read(x, positions, memory_keys, memory))


class Decoder(nn.Module):
    """All action queries in parallel, from zero content and learned positions (ACT; DETR's object queries).

    ACT's first layer attends between queries whose content is all zeros. Every value is then the same
    vector, so its output is the same vector for each query and each input, whatever the weights: with
    dropout off, that whole sub-layer (attention, projection, residual, and norm in post-norm order) is a
    constant. Here it is one learned vector, ``start``. Outputs and gradients equal ACT's without dropout
    (tests/parity); with dropout, the noise that ACT puts on this constant is left out. Queries first
    interact in the second layer.
    """

    def __init__(self, spec: LayerSpec, n_layers: int, n_queries: int):
        super().__init__()
        self.start = nn.Parameter(torch.zeros(spec.dim))
        self.query_positions = nn.Parameter(torch.randn(n_queries, spec.dim))
        self.layers = nn.ModuleList(DecoderLayer(spec, queries_interact=i > 0) for i in range(n_layers))
        self.norm = nn.LayerNorm(spec.dim)
        init_like_act(self)

    def forward(
        self,
        memory: Float[Tensor, "B N D"],
        memory_positions: Float[Tensor, "N D"],
        n_queries: int | None = None,
    ) -> Float[Tensor, "B Q D"]:
        """Decode the first ``n_queries`` action queries (default: all).

        With several layers all queries are computed, since later layers let them interact.
        """
        needed = n_queries if len(self.layers) == 1 else None
        positions = self.query_positions[:needed]
        memory_keys = memory + memory_positions
        x = self.start.expand(1, 1, -1)
        for layer in self.layers:
            x = layer(x, positions, memory_keys, memory)
        return self.norm(x[:, :n_queries])


def init_like_act(stack: nn.Module) -> None:
    """Xavier-uniform matrices and zero attention biases, as ACT.

    ACT initialises query, key and value as one (3D, D) matrix; the gain gives each of ours the same range.
    """
    for layer in stack.modules():
        if isinstance(layer, Attention):
            for projection in (layer.q_proj, layer.k_proj, layer.v_proj):
                nn.init.xavier_uniform_(projection.weight, gain=0.5**0.5)
            nn.init.xavier_uniform_(layer.out_proj.weight)
            for projection in (layer.q_proj, layer.v_proj, layer.out_proj):
                nn.init.zeros_(projection.bias)
        elif isinstance(layer, FeedForward):
            for linear in (layer.expand, layer.contract):
                nn.init.xavier_uniform_(linear.weight)
