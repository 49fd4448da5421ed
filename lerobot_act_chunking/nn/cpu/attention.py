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

    Attention is linear in its values, and its scores are linear in its keys. Where there is a single query,
    or there are more queries than keys of all heads, the projections are taken on the side that has fewer
    tokens.
    """

    linear = Linear

    def forward(
        self,
        queries: Float[Tensor, "#B Q D"],
        keys: Float[Tensor, "B N D"],
        values: Float[Tensor, "B N D"],
        is_pad: Bool[Tensor, "B N"] | None = None,
        *,
        causal: bool = False,
    ) -> Float[Tensor, "B Q D"]:
        """See `Attention`."""
        if queries.shape[1] == 1 and keys.shape[1] > self.n_heads and is_plain(self.k_proj, self.v_proj):
            mask = None if is_pad is None else ~is_pad[:, None, None, :]
            return self._attend_single_query(queries, keys, values, mask)
        return super().forward(queries, keys, values, is_pad, causal=causal)

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
        weights = self._attention_weights(self.split_heads(self.q_proj(queries)), keys, mask)
        from_head = self.out_proj.weight.t().unflatten(0, (self.n_heads, -1))
        return Span(weights.transpose(1, 2).flatten(2), (values @ from_head).flatten(1, 2))

    def attend_projected(
        self,
        queries: Float[Tensor, "#B H Q d"],
        keys: Float[Tensor, "B H N d"],
        values: Float[Tensor, "B H N d"],
        mask: Bool[Tensor, "B 1 1 N"] | None,
        *,
        causal: bool = False,
    ) -> Float[Tensor, "B Q D"]:
        """See `Attention`; dropout draws its masks faster than PyTorch's kernel does on a CPU."""
        if self.training and self.dropout.p > 0 and queries.device.type == "cpu" and not causal:
            return self.join_heads(self._attention_weights(queries, keys, mask) @ values)
        return super().attend_projected(queries, keys, values, mask, causal=causal)

    def _attend_single_query(
        self,
        query: Float[Tensor, "#B 1 D"],
        keys: Float[Tensor, "B N D"],
        values: Float[Tensor, "B N D"],
        mask: Bool[Tensor, "B 1 1 N"] | None,
    ) -> Float[Tensor, "B 1 D"]:
        """Project the query to the keys and the weighted mean of the values, not every key and value."""
        to_keys, to_values = (
            proj.weight.unflatten(0, (self.n_heads, -1)) for proj in (self.k_proj, self.v_proj)
        )
        projected = self.split_heads(self.q_proj(query)) @ to_keys
        weights = self._attention_weights(projected, keys[:, None], mask)
        found = weights @ values[:, None] @ to_values.transpose(-1, -2)
        # With dropout the weights do not add up to one, and the values' bias counts as often as they do.
        found = found + weights.sum(-1, keepdim=True) * self.v_proj.bias.view(self.n_heads, 1, -1)
        return self.join_heads(found)

    def _attention_weights(
        self,
        queries: Float[Tensor, "#B H Q k"],
        keys: Float[Tensor, "B #H N k"],
        mask: Bool[Tensor, "B 1 1 N"] | None,
    ) -> Float[Tensor, "B H Q N"]:
        """Weight of each key for every query, after dropout."""
        scores = (queries * self.head_dim**-0.5) @ keys.transpose(-1, -2)
        if mask is not None:
            scores = scores.masked_fill(~mask, float("-inf"))
        return self.dropout(scores.softmax(-1))
