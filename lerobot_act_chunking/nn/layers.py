"""The sub-layers of a transformer, in both norm orders, as the papers write them.

Positions are added to queries and keys of every layer, never to values (DETR, Carion et al. 2020).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from jaxtyping import Bool, Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.attention import Attention
from lerobot_act_chunking.nn.dropout import Dropout

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


class AttentionLayer(Residual):
    """A branch that attends."""

    attention_type: type[Attention] = Attention

    def __init__(self, spec: LayerSpec):
        super().__init__(spec)
        self.attention = self.attention_type(spec.dim, spec.n_heads, spec.dropout)


class SelfAttention(AttentionLayer):
    """Tokens attend to each other."""

    def forward(
        self,
        x: Float[Tensor, "#B #N D"],
        positions: Float[Tensor, "N D"],
        is_pad: Bool[Tensor, "#B N"] | None = None,
        n_out: int | None = None,
        *,
        causal: bool = False,
    ) -> Float[Tensor, "B M D"]:
        """Update the first ``n_out`` tokens (all by default) from all tokens; the others only serve as keys.

        With ``causal``, tokens attend to themselves and to those before them.
        """

        def attend(y: Tensor) -> Tensor:
            placed = y + positions
            return self.attention(placed[:, :n_out], placed, y, is_pad, causal=causal)

        return self.add(x, attend)


class CrossAttention(AttentionLayer):
    """Queries attend to a memory."""

    def forward(
        self,
        x: Float[Tensor, "#B #Q D"],
        positions: Float[Tensor, "Q D"],
        memory_keys: Float[Tensor, "B N D"],
        memory: Float[Tensor, "B N D"],
    ) -> Float[Tensor, "B Q D"]:
        """Add to each query what it finds in ``memory``; ``memory_keys`` is ``memory`` with its positions."""
        return self.add(x, lambda y: self.attention(y + positions, memory_keys, memory))


class FeedForward(Residual):
    """Two linear layers on every token, with an activation between them."""

    linear: type[nn.Linear] = nn.Linear

    def __init__(self, spec: LayerSpec):
        super().__init__(spec)
        self.expand = self.linear(spec.dim, spec.dim_feedforward)
        activation = nn.ReLU() if spec.activation == "relu" else nn.GELU()
        self.activation = nn.Sequential(activation, Dropout(spec.dropout))
        self.contract = self.linear(spec.dim_feedforward, spec.dim)

    def forward(self, x: Float[Tensor, "B N D"]) -> Float[Tensor, "B N D"]:
        """Refine every token on its own."""
        return self.add(x, lambda y: self.contract(self.activation(self.expand(y))))
