"""How far the chunk to come is from the one its codes stand for."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from lerobot_act_chunking.heads.codes import make_trunk


class ConditionedOffset(nn.Module):
    """An offset that sees the decoded chunk, whatever tokenizer it comes from; zero at first.

    Args:
        dim: width D of features.
        hidden_dims: hidden layers.
        chunk_size: C.
        action_dim: A.
    """

    def __init__(self, dim: int, hidden_dims: tuple[int, ...], chunk_size: int, action_dim: int):
        super().__init__()
        size = chunk_size * action_dim
        self.shape = (chunk_size, action_dim)
        self.trunk = make_trunk(dim + size, hidden_dims)
        self.readout = nn.Linear(hidden_dims[-1] if hidden_dims else dim + size, size)
        nn.init.zeros_(self.readout.weight)
        nn.init.zeros_(self.readout.bias)

    def forward(
        self, features: Float[Tensor, "N D"], codes: Int64[Tensor, "N G"], decoded: Float[Tensor, "N C A"]
    ) -> Float[Tensor, "N C A"]:
        """The offset of the chunk ``decoded``."""
        seen = torch.cat((features, decoded.flatten(1)), dim=-1)
        return self.readout(self.trunk(seen)).unflatten(-1, self.shape)


class TableOffset(nn.Module):
    """An offset for every value of every code, of which those of the codes given are summed (LeRobot).

    Args:
        dim: width D of features.
        hidden_dims: hidden layers.
        n_codes: G.
        vocabulary: M.
        chunk_size: C.
        action_dim: A.
    """

    def __init__(
        self,
        dim: int,
        hidden_dims: tuple[int, ...],
        n_codes: int,
        vocabulary: int,
        chunk_size: int,
        action_dim: int,
    ):
        super().__init__()
        self.shape = (n_codes, vocabulary, chunk_size, action_dim)
        self.trunk = make_trunk(dim, hidden_dims)
        width = hidden_dims[-1] if hidden_dims else dim
        self.readout = nn.Linear(width, n_codes * vocabulary * chunk_size * action_dim)

    def forward(
        self, features: Float[Tensor, "N D"], codes: Int64[Tensor, "N G"], decoded: Float[Tensor, "N C A"]
    ) -> Float[Tensor, "N C A"]:
        """The sum of the codes' offsets."""
        table = self.readout(self.trunk(features)).unflatten(-1, self.shape)
        rows = torch.arange(len(features), device=features.device)[:, None]
        levels = torch.arange(self.shape[0], device=features.device)
        return table[rows, levels, codes].sum(1)
