"""How far the chunk to come is from the one its codes stand for."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from lerobot_act_chunking.heads.codes import make_trunk


class ConditionedOffset(nn.Module):
    """An offset that sees the decoded chunk, whatever tokenizer it comes from.

    It is zero at first: training starts from the decoded chunks.

    Args:
        dim: width D of features.
        hidden_dims: hidden layers.
        chunk_size: C.
        action_dim: A.
    """

    def __init__(self, dim: int, hidden_dims: tuple[int, ...], chunk_size: int, action_dim: int):
        super().__init__()
        self.shape = (chunk_size, action_dim)
        size = chunk_size * action_dim
        self.trunk, width = make_trunk(dim + size, hidden_dims)
        self.readout = nn.Linear(width, size)
        nn.init.zeros_(self.readout.weight)
        nn.init.zeros_(self.readout.bias)

    def forward(
        self, features: Float[Tensor, "N D"], codes: Int64[Tensor, "N G"], decoded: Float[Tensor, "N C A"]
    ) -> Float[Tensor, "N C A"]:
        """The offset of the chunk ``decoded``; it stands for its ``codes``."""
        seen = torch.cat((features, decoded.flatten(1)), dim=-1)
        return self.readout(self.trunk(seen)).unflatten(-1, self.shape)


class TableOffset(nn.Module):
    """An offset for every value of every code; those of the codes at hand are summed, as in LeRobot.

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
        self.table_shape = (n_codes, vocabulary, chunk_size * action_dim)
        self.shape = (chunk_size, action_dim)
        self.trunk, width = make_trunk(dim, hidden_dims)
        self.readout = nn.Linear(width, n_codes * vocabulary * chunk_size * action_dim)

    def forward(
        self, features: Float[Tensor, "N D"], codes: Int64[Tensor, "N G"], decoded: Float[Tensor, "N C A"]
    ) -> Float[Tensor, "N C A"]:
        """The sum of the offsets of ``codes``; ``decoded`` has no part in it."""
        table = self.readout(self.trunk(features)).unflatten(-1, self.table_shape)
        of_codes = table.take_along_dim(codes[..., None, None], dim=2)  # (N, G, 1, C * A)
        return of_codes.sum((1, 2)).unflatten(-1, self.shape)
