"""A causal transformer in the manner of GPT-2."""

import math

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.dropout import Dropout

INIT_STD = 0.02


class GptBlock(nn.Module):
    """Causal self-attention, then a feed-forward branch, in pre-norm order (GPT-2, Radford et al. 2019)."""

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
        self.dropout = Dropout(dropout)

    def forward(self, x: Float[Tensor, "B L D"], n_last: int | None = None) -> Float[Tensor, "B M D"]:
        """The tokens, or the last ``n_last`` of them, after looking at themselves and those before."""
        y = self.norm1(x)
        x = x if n_last is None else x[:, -n_last:]
        x = x + self.dropout(self.mix(self._attend(y, x.shape[1])))
        return x + self.dropout(self.contract(F.gelu(self.expand(self.norm2(x)))))

    def _attend(self, y: Float[Tensor, "B L D"], n_queries: int) -> Float[Tensor, "B M D"]:
        """What the last ``n_queries`` tokens find among those up to themselves."""
        heads = (part.unflatten(-1, (self.n_heads, -1)).transpose(1, 2) for part in self.qkv(y).chunk(3, -1))
        q, k, v = heads
        length = k.shape[2]
        mixed = F.scaled_dot_product_attention(
            q[:, :, -n_queries:],
            k,
            v,
            attn_mask=_last_rows_of_causal_mask(n_queries, length, y.device) if n_queries < length else None,
            dropout_p=self.attention_dropout if self.training else 0.0,
            is_causal=n_queries == length,
        )
        return mixed.transpose(1, 2).flatten(2)


def _last_rows_of_causal_mask(n_rows: int, length: int, device: torch.device) -> Tensor | None:
    """Which tokens the last ones see; None for the very last, which sees all."""
    if n_rows == 1:
        return None
    return torch.ones(n_rows, length, dtype=torch.bool, device=device).tril(length - n_rows)


class Gpt(nn.Module):
    """Pre-norm causal transformer with learned absolute positions and GPT-2's initial weights.

    LeRobot's VQ-BeT (and minGPT) put one more linear map before it and one behind it. Both stand next to
    linear maps, of the inputs and of the heads, and are left out.

    Args:
        dim: token width D.
        n_heads: attention heads; divides ``dim``.
        n_layers: blocks.
        max_tokens: longest sequence.
        dropout: probability, on tokens, attention weights and every residual branch.

    Raises:
        ConfigurationError: ``n_heads`` does not divide ``dim``.
    """

    def __init__(self, *, dim: int, n_heads: int, n_layers: int, max_tokens: int, dropout: float):
        super().__init__()
        if dim % n_heads:
            raise ConfigurationError(f"gpt_n_head={n_heads} must divide gpt_hidden_dim={dim}")
        self.dim = dim
        self.positions = nn.Parameter(INIT_STD * torch.randn(max_tokens, dim))
        self.dropout = Dropout(dropout)
        blocks = [GptBlock(dim, n_heads, dropout) for _ in range(n_layers)]
        for block in blocks:
            block.apply(_init_like_gpt2)
            nn.init.normal_(block.mix.weight, std=INIT_STD / math.sqrt(2 * n_layers))
        self.blocks = nn.ModuleList(blocks)
        self.norm = nn.LayerNorm(dim)

    def forward(self, tokens: Float[Tensor, "B L D"], n_last: int | None = None) -> Float[Tensor, "B M D"]:
        """Features of all tokens, or of the last ``n_last`` alone: the last block skips the others.

        Raises:
            ValueError: more tokens than ``max_tokens``.
        """
        length, longest = tokens.shape[1], len(self.positions)
        if length > longest:
            raise ValueError(f"{length} tokens, but this GPT has positions for max_tokens={longest}")
        x = self.dropout(tokens + self.positions[:length])
        *body, last = self.blocks
        for block in body:
            x = block(x)
        return self.norm(last(x, n_last))


def _init_like_gpt2(module: nn.Module) -> None:
    if isinstance(module, nn.Linear):
        nn.init.normal_(module.weight, std=INIT_STD)
        nn.init.zeros_(module.bias)
