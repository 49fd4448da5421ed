"""`nn.attention.Attention`, with projections on the side that has fewer tokens."""

from jaxtyping import Bool, Float
from torch import Tensor

from lerobot_act_chunking.nn.attention import Attention
from lerobot_act_chunking.nn.cpu.linear import Linear, is_plain
from lerobot_act_chunking.nn.cpu.span import Span

# Multiplications that a projection must have before leaving it out pays on a CPU.
_WORTH_A_DETOUR = 2**22


class CpuAttention(Attention):
    """Attention whose results are those of `Attention` up to rounding.

    Attention is linear in its values. Where there are more queries than keys of all heads, the output
    projection is taken on the side of the keys.
    """

    linear = Linear

    def attend(
        self,
        queries: Float[Tensor, "#B Q D"],
        keys: Float[Tensor, "B H N d"],
        values: Float[Tensor, "B H N d"],
        mask: Bool[Tensor, "B 1 1 N"] | None = None,
        *,
        causal: bool = False,
    ) -> Float[Tensor, "B Q D"]:
        """See `Attention`."""
        if self.factored_is_cheaper(queries.shape[1], keys.shape[2]):
            found = self.attend_factored(queries, keys, values, mask)
            return found.tokens() + self.out_proj.bias
        return super().attend(queries, keys, values, mask, causal=causal)

    def attend_span(
        self, x: Span, positions: Float[Tensor, "N D"], is_pad: Bool[Tensor, "B N"] | None
    ) -> Float[Tensor, "B N D"]:
        """Attend from all of ``x`` to all of it, as `forward` with ``x + positions`` as queries and keys."""
        q, k = (self.split_heads(x.through(layer, positions)) for layer in (self.q_proj, self.k_proj))
        mask = None if is_pad is None else ~is_pad[:, None, None, :]
        return self.attend_projected(q, k, self.split_heads(x.through(self.v_proj)), mask)

    def factored_is_cheaper(self, n_queries: int, n_keys: int) -> bool:
        """Whether the keys of all heads are fewer than the queries, and `attend_factored` saves time."""
        few = self.n_heads * n_keys < n_queries
        return few and n_queries * self.out_proj.weight.numel() > _WORTH_A_DETOUR and is_plain(self.out_proj)

    def attend_factored(
        self,
        queries: Float[Tensor, "#B Q D"],
        keys: Float[Tensor, "B H N d"],
        values: Float[Tensor, "B H N d"],
        mask: Bool[Tensor, "B 1 1 N"] | None = None,
    ) -> Span:
        """`attend` without the last bias, as weights (queries by keys) and a vector for each key."""
        scores = (self.split_heads(self.q_proj(queries)) * self.head_dim**-0.5) @ keys.transpose(-1, -2)
        if mask is not None:
            scores = scores.masked_fill(~mask, float("-inf"))
        weights = self.dropout(scores.softmax(-1))
        from_head = self.out_proj.weight.t().unflatten(0, (self.n_heads, -1))
        return Span(weights.transpose(1, 2).flatten(2), (values @ from_head).flatten(1, 2))
