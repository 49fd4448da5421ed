"""Transformer encoder and DETR-style decoder.

The layers are those of `nn.layers`, in the form that is faster on a CPU (`nn.cpu`).
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.attention import Attention
from lerobot_act_chunking.nn.cpu.layers import CrossAttention, FeedForward, SelfAttention
from lerobot_act_chunking.nn.cpu.span import Tokens
from lerobot_act_chunking.nn.layers import LayerSpec


class EncoderLayer(nn.Module):
    """Self-attention, then feed-forward."""

    def __init__(self, spec: LayerSpec):
        super().__init__()
        self.mix = SelfAttention(spec)
        self.refine = FeedForward(spec)

    def forward(
        self,
        x: Tokens,
        positions: Float[Tensor, "N D"],
        is_pad: Bool[Tensor, "B N"] | None = None,
        n_out: int | None = None,
    ) -> Float[Tensor, "B M D"]:
        """Encode the first ``n_out`` tokens (all by default), which attend to all others."""
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
        x: Tokens,
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
        """Update queries ``x`` from ``memory``; ``causal`` ones do not attend to later ones."""
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
