"""Multi-head attention on PyTorch's fused kernel."""

import torch.nn.functional as F  # noqa: N812
from jaxtyping import Bool, Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.dropout import Dropout
from lerobot_act_chunking.nn.linear import Linear, is_plain
from lerobot_act_chunking.nn.span import Span

# Multiplications that a projection must have before doing without it pays on a CPU.
_WORTH_A_DETOUR = 2**22


class Attention(nn.Module):
    """Scaled dot-product attention with its own projections ("Attention Is All You Need", eq. 1).

    ``nn.MultiheadAttention`` as LeRobot calls it builds the averaged attention weights on every call, which
    rules out the fused kernels. The key projection has no bias: it adds the same score to every key of a
    query, which the softmax removes.

    Attention is linear in its values, and its scores are linear in its keys. Where there is a single query,
    or there are more queries than keys of all heads, the projections are therefore taken on the side that
    has fewer tokens. The results are the same up to rounding.
    """

    def __init__(self, dim: int, n_heads: int, dropout: float):
        super().__init__()
        self.n_heads, self.head_dim = n_heads, dim // n_heads
        self.dropout = Dropout(dropout)
        self.q_proj = Linear(dim, dim)
        self.k_proj = Linear(dim, dim, bias=False)
        self.v_proj = Linear(dim, dim)
        self.out_proj = Linear(dim, dim)

    def forward(
        self,
        queries: Float[Tensor, "#B Q D"],
        keys: Float[Tensor, "B N D"],
        values: Float[Tensor, "B N D"],
        is_pad: Bool[Tensor, "B N"] | None = None,
        *,
        causal: bool = False,
    ) -> Float[Tensor, "B Q D"]:
        """Attend from ``queries`` to ``keys``; keys marked in ``is_pad`` are ignored.

        Queries shared by the whole batch (leading size 1) are projected once. ``causal`` queries attend to
        the keys up to their own place.
        """
        mask = None if is_pad is None else ~is_pad[:, None, None, :]
        if queries.shape[1] == 1 and keys.shape[1] > self.n_heads and is_plain(self.k_proj, self.v_proj):
            return self._attend_single_query(queries, keys, values, mask)
        return self.attend(queries, *self.project_keys_values(keys, values), mask, causal=causal)

    def project_keys_values(
        self, keys: Float[Tensor, "B N D"], values: Float[Tensor, "B N D"]
    ) -> tuple[Float[Tensor, "B H N d"], Float[Tensor, "B H N d"]]:
        """Keys and values as `attend` takes them; project once what several queries attend to."""
        return self._heads(self.k_proj(keys)), self._heads(self.v_proj(values))

    def attend(
        self,
        queries: Float[Tensor, "#B Q D"],
        keys: Float[Tensor, "B H N d"],
        values: Float[Tensor, "B H N d"],
        mask: Bool[Tensor, "B 1 1 N"] | None = None,
        *,
        causal: bool = False,
    ) -> Float[Tensor, "B Q D"]:
        """Attend from ``queries`` to projected keys and values, only where ``mask`` is true."""
        if self.factored_is_cheaper(queries.shape[1], keys.shape[2]):
            found = self.attend_factored(queries, keys, values, mask)
            return found.tokens() + self.out_proj.bias
        return self._attend(self._heads(self.q_proj(queries)), keys, values, mask, causal=causal)

    def attend_span(
        self, x: Span, positions: Float[Tensor, "N D"], is_pad: Bool[Tensor, "B N"] | None
    ) -> Float[Tensor, "B N D"]:
        """Attend from all of ``x`` to all of it, as `forward` with ``x + positions`` as queries and keys."""
        q, k = (self._heads(x.through(layer, positions)) for layer in (self.q_proj, self.k_proj))
        mask = None if is_pad is None else ~is_pad[:, None, None, :]
        return self._attend(q, k, self._heads(x.through(self.v_proj)), mask)

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
        weights = self._attention_weights(self._heads(self.q_proj(queries)), keys, mask)
        from_head = self.out_proj.weight.t().unflatten(0, (self.n_heads, -1))
        return Span(weights.transpose(1, 2).flatten(2), (values @ from_head).flatten(1, 2))

    def _attend(
        self,
        q: Float[Tensor, "#B H Q d"],
        keys: Float[Tensor, "B H N d"],
        values: Float[Tensor, "B H N d"],
        mask: Bool[Tensor, "B 1 1 N"] | None,
        *,
        causal: bool = False,
    ) -> Float[Tensor, "B Q D"]:
        if self.training and self.dropout.p > 0 and q.device.type == "cpu" and not causal:
            mixed = self._attention_weights(q, keys, mask) @ values
        else:
            dropout = self.dropout.p if self.training else 0.0
            q = q.expand(len(keys), -1, -1, -1)
            mixed = F.scaled_dot_product_attention(
                q, keys, values, attn_mask=mask, dropout_p=dropout, is_causal=causal
            )
        return self.out_proj(mixed.transpose(1, 2).flatten(2))

    def _attend_single_query(
        self,
        query: Float[Tensor, "#B 1 D"],
        keys: Float[Tensor, "B N D"],
        values: Float[Tensor, "B N D"],
        mask: Bool[Tensor, "B 1 1 N"] | None,
    ) -> Float[Tensor, "B 1 D"]:
        """One query: its image under the keys' projection meets the keys, their mean that of the values."""
        to_keys, to_values = (
            proj.weight.unflatten(0, (self.n_heads, -1)) for proj in (self.k_proj, self.v_proj)
        )
        looked = self._heads(self.q_proj(query)) @ to_keys
        weights = self._attention_weights(looked, keys[:, None], mask)
        mixed = weights @ values[:, None] @ to_values.transpose(-1, -2)
        # With dropout the weights do not add up to one, and the values' bias counts as often as they do.
        mixed = mixed + weights.sum(-1, keepdim=True) * self.v_proj.bias.view(self.n_heads, 1, -1)
        return self.out_proj(mixed.transpose(1, 2).flatten(2))

    def _attention_weights(
        self,
        queries: Float[Tensor, "#B H Q k"],
        keys: Float[Tensor, "B #H N k"],
        mask: Bool[Tensor, "B 1 1 N"] | None,
    ) -> Float[Tensor, "B H Q N"]:
        """How much of each key every query takes, after dropout."""
        scores = (queries * self.head_dim**-0.5) @ keys.transpose(-1, -2)
        if mask is not None:
            scores = scores.masked_fill(~mask, float("-inf"))
        return self.dropout(scores.softmax(-1))

    def _heads(self, x: Float[Tensor, "B N D"]) -> Float[Tensor, "B H N d"]:
        return x.unflatten(-1, (self.n_heads, -1)).transpose(1, 2)
