"""Multi-head attention on PyTorch's fused kernel."""

import torch.nn.functional as F  # noqa: N812
from jaxtyping import Bool, Float
from torch import Tensor, nn


class Attention(nn.Module):
    """Scaled dot-product attention with its own projections ("Attention Is All You Need", eq. 1).

    ``nn.MultiheadAttention`` as LeRobot calls it builds the averaged attention weights on every call, which
    rules out the fused kernels. The key projection has no bias: it adds the same score to every key of a
    query, which the softmax removes.
    """

    def __init__(self, dim: int, n_heads: int, dropout: float):
        super().__init__()
        self.n_heads = n_heads
        self.dropout = dropout
        self.q_proj = nn.Linear(dim, dim)
        self.k_proj = nn.Linear(dim, dim, bias=False)
        self.v_proj = nn.Linear(dim, dim)
        self.out_proj = nn.Linear(dim, dim)

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
        return self.read(queries, *self.remember(keys, values), mask, causal=causal)

    def remember(
        self, keys: Float[Tensor, "B N D"], values: Float[Tensor, "B N D"]
    ) -> tuple[Float[Tensor, "B H N d"], Float[Tensor, "B H N d"]]:
        """Keys and values as `read` takes them; worth keeping if they are read several times."""
        return self._heads(self.k_proj(keys)), self._heads(self.v_proj(values))

    def read(
        self,
        queries: Float[Tensor, "#B Q D"],
        keys: Float[Tensor, "B H N d"],
        values: Float[Tensor, "B H N d"],
        mask: Bool[Tensor, "B 1 1 N"] | None = None,
        *,
        causal: bool = False,
    ) -> Float[Tensor, "B Q D"]:
        """Attend from ``queries`` to what `remember` made; only where ``mask`` is true."""
        q = self._heads(self.q_proj(queries)).expand(len(keys), -1, -1, -1)
        dropout = self.dropout if self.training else 0.0
        mixed = F.scaled_dot_product_attention(
            q, keys, values, attn_mask=mask, dropout_p=dropout, is_causal=causal
        )
        return self.out_proj(mixed.transpose(1, 2).flatten(2))

    def _heads(self, x: Float[Tensor, "B N D"]) -> Float[Tensor, "B H N d"]:
        return x.unflatten(-1, (self.n_heads, -1)).transpose(1, 2)
