"""The sub-layers of `nn.layers` for tokens that are combinations of a few vectors."""

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Bool, Float
from torch import Tensor

from lerobot_act_chunking.nn import layers
from lerobot_act_chunking.nn.cpu.attention import CpuAttention
from lerobot_act_chunking.nn.cpu.linear import Linear, is_plain
from lerobot_act_chunking.nn.cpu.span import Span


class SelfAttention(layers.SelfAttention):
    """`nn.layers.SelfAttention`; tokens of a `Span` are projected by its vectors."""

    attention: CpuAttention
    attention_type = CpuAttention

    def forward(
        self,
        x: Float[Tensor, "#B #N D"] | Span,
        positions: Float[Tensor, "N D"],
        is_pad: Bool[Tensor, "#B N"] | None = None,
        n_out: int | None = None,
        *,
        causal: bool = False,
    ) -> Float[Tensor, "B M D"]:
        """See `nn.layers.SelfAttention`."""
        if not isinstance(x, Span):
            return super().forward(x, positions, is_pad, n_out, causal=causal)
        attention = self.attention
        plain = is_plain(attention.q_proj, attention.k_proj, attention.v_proj)
        if not plain or self.pre_norm or n_out or causal:
            return super().forward(x.tokens(), positions, is_pad, n_out, causal=causal)
        return self.add(x.tokens(), lambda _: attention.attend_span(x, positions, is_pad))


class CrossAttention(layers.CrossAttention):
    """`nn.layers.CrossAttention`; queries of the same content that find few keys become a `Span`."""

    attention: CpuAttention
    attention_type = CpuAttention

    def forward(  # pyright: ignore[reportIncompatibleMethodOverride]  (FeedForward here takes both)
        self,
        x: Float[Tensor, "#B #Q D"],
        positions: Float[Tensor, "Q D"],
        memory_keys: Float[Tensor, "B N D"],
        memory: Float[Tensor, "B N D"],
    ) -> Float[Tensor, "B Q D"] | Span:
        """See `nn.layers.CrossAttention`."""
        attention = self.attention
        same = x.shape[:2] == (1, 1) and not self.pre_norm and not (self.training and self.dropout.p)
        if not same or not attention.factored_is_cheaper(len(positions), memory.shape[1]):
            return super().forward(x, positions, memory_keys, memory)
        found = attention.attend_factored(x + positions, *attention.project_keys_values(memory_keys, memory))
        start = (x + attention.out_proj.bias).expand(len(memory), -1, -1)
        sums = Span(F.pad(found.weights, (0, 1), value=1.0), torch.cat((found.vectors, start), dim=1))
        return sums.normalized(self.norm)


class FeedForward(layers.FeedForward):
    """`nn.layers.FeedForward`; tokens of a `Span` are expanded by its vectors."""

    linear = Linear

    def forward(self, x: Float[Tensor, "B N D"] | Span) -> Float[Tensor, "B N D"]:
        """See `nn.layers.FeedForward`."""
        if not isinstance(x, Span):
            return super().forward(x)
        if not is_plain(self.expand) or self.pre_norm:
            return super().forward(x.tokens())
        return self.add(x.tokens(), lambda _: self.contract(self.activation(x.through(self.expand))))
