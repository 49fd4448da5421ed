"""A causal transformer in the manner of GPT-2."""

import math

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn

INIT_STD = 0.02


class GptBlock(nn.Module):
    """Causal self-attention and a feed-forward branch, both normalised before (GPT-2, Radford et al. 2019)."""

    def __init__(self, dim: int, n_heads: int, dropout: float):
        super().__init__()
        self.n_heads = n_heads
        self.attention_dropout = dropout
        self.norm1 = nn.LayerNorm(dim)
        self.qkv = nn.Linear(dim, 3 * dim)
        self.mix = nn.Linear(dim, dim)
        self.norm2 = nn.LayerNorm(dim)
        self.expand = nn.Linear(dim, 4 * dim)
        self.contract = nn.Linear(4 * dim, dim)
        self.dropout = nn.Dropout(dropout)

    def forward(self, x: Float[Tensor, "B L D"], n_last: int | None = None) -> Float[Tensor, "B M D"]:
        """The tokens, or the last ``n_last`` of them, after looking at themselves and those before."""
        y = self.norm1(x)
        kept = x.shape[1] if n_last is None else n_last
        x = x[:, -kept:]
        x = x + self.dropout(self.mix(self._attend(y, kept)))
        return x + self.dropout(self.contract(F.gelu(self.expand(self.norm2(x)))))

    def _attend(self, y: Float[Tensor, "B L D"], kept: int) -> Float[Tensor, "B M D"]:
        q, k, v = (part.unflatten(-1, (self.n_heads, -1)).transpose(1, 2) for part in self.qkv(y).chunk(3, -1))
        q = q[:, :, -kept:]
        length = k.shape[2]
        mask = None
        if 1 < kept < length:
            mask = torch.ones(kept, length, dtype=torch.bool, device=y.device).tril(length - kept)
        dropout = self.attention_dropout if self.training else 0.0
        mixed = F.scaled_dot_product_attention(
            q, k, v, attn_mask=mask, dropout_p=dropout, is_causal=kept == length
        )
        return mixed.transpose(1, 2).flatten(2)


class Gpt(nn.Module):
    """Pre-norm causal transformer with learned absolute positions and GPT-2's initial weights.

    LeRobot's VQ-BeT (and minGPT) put one more linear map before it and one behind it. Both stand next to
    linear maps, of the inputs and of the heads, and are left out.

    Args:
        dim: token width D.
        n_heads: attention heads; divides ``dim``.
        n_layers: blocks.
        max_tokens: longest sequence.
        dropout: dropout probability.
    """

    def __init__(self, *, dim: int, n_heads: int, n_layers: int, max_tokens: int, dropout: float):
        super().__init__()
        self.dim = dim
        self.positions = nn.Parameter(INIT_STD * torch.randn(max_tokens, dim))
        self.dropout = nn.Dropout(dropout)
        self.blocks = nn.ModuleList(GptBlock(dim, n_heads, dropout) for _ in range(n_layers))
        self.norm = nn.LayerNorm(dim)
        for block in self.blocks:
            for name, weight in block.named_parameters():
                if "norm" not in name:
                    nn.init.zeros_(weight) if name.endswith("bias") else nn.init.normal_(weight, std=INIT_STD)
            nn.init.normal_(block.mix.weight, std=INIT_STD / math.sqrt(2 * n_layers))

    def forward(self, tokens: Float[Tensor, "B L D"], n_last: int | None = None) -> Float[Tensor, "B M D"]:
        """Features of all tokens, or of the last ``n_last`` alone, for which the last block saves the rest."""
        x = self.dropout(tokens + self.positions[: tokens.shape[1]])
        for block in self.blocks[:-1]:
            x = block(x)
        return self.norm(self.blocks[-1](x, n_last))
