"""Multi-head attention on PyTorch's fused kernel."""

import torch.nn.functional as F  # noqa: N812
from jaxtyping import Bool, Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.dropout import Dropout


class Attention(nn.Module):
    """Scaled dot-product attention with its own projections ("Attention Is All You Need", eq. 1).

    ``nn.MultiheadAttention`` as LeRobot calls it builds the averaged attention weights on every call, which
    rules out the fused kernels. The key projection has no bias: it adds the same score to every key of a
    query, which the softmax removes.
    """

    linear: type[nn.Linear] = nn.Linear
    """Class of the projections."""

    def __init__(self, dim: int, n_heads: int, dropout: float):
        super().__init__()
        self.n_heads, self.head_dim = n_heads, dim // n_heads
        self.dropout = Dropout(dropout)
        self.q_proj = self.linear(dim, dim)
        self.k_proj = self.linear(dim, dim, bias=False)
        self.v_proj = self.linear(dim, dim)
        self.out_proj = self.linear(dim, dim)

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
        return self.attend(queries, *self.project_keys_values(keys, values), mask, causal=causal)

    def project_keys_values(
        self, keys: Float[Tensor, "B N D"], values: Float[Tensor, "B N D"]
    ) -> tuple[Float[Tensor, "B H N d"], Float[Tensor, "B H N d"]]:
        """Keys and values as `attend` takes them; project once what several queries attend to."""
        return self.split_heads(self.k_proj(keys)), self.split_heads(self.v_proj(values))

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
        return self.attend_projected(
            self.split_heads(self.q_proj(queries)), keys, values, mask, causal=causal
        )

    def attend_projected(
        self,
        queries: Float[Tensor, "#B H Q d"],
        keys: Float[Tensor, "B H N d"],
        values: Float[Tensor, "B H N d"],
        mask: Bool[Tensor, "B 1 1 N"] | None,
        *,
        causal: bool = False,
    ) -> Float[Tensor, "B Q D"]:
        """`attend` with projected queries."""
        dropout = self.dropout.p if self.training else 0.0
        queries = queries.expand(len(keys), -1, -1, -1)
        values = F.scaled_dot_product_attention(
            queries, keys, values, attn_mask=mask, dropout_p=dropout, is_causal=causal
        )
        return self.join_heads(values)

    def split_heads(self, x: Float[Tensor, "B N D"]) -> Float[Tensor, "B H N d"]:
        """Each token as one vector per head."""
        return x.unflatten(-1, (self.n_heads, -1)).transpose(1, 2)

    def join_heads(self, x: Float[Tensor, "B H N d"]) -> Float[Tensor, "B N D"]:
        """The output projection of what all heads found."""
        return self.out_proj(x.transpose(1, 2).flatten(2))
