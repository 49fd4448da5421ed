"""Actions that a chunk has to begin with, as something a network can look at."""

from functools import partial
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.processes import draw_rows


class GivenActions(NamedTuple):
    """The first actions of a chunk where they are given.

    Attributes:
        actions: (B, P, A), normalised; anything where they are not given.
        given: (B, P), which of them are.
    """

    actions: Tensor
    given: Tensor

    def repeat(self, n_samples: int) -> "GivenActions":
        """The same for every one of ``n_samples`` samples of each environment, sample by sample."""
        return GivenActions(self.actions.repeat(n_samples, 1, 1), self.given.repeat(n_samples, 1))


class PrefixEncoder(nn.Module):
    """Given first actions as one vector, to be added to a token: training-time real-time chunking.

    Black et al. 2025b give a denoiser the actions themselves, at a noise level of none. A network that
    regresses its chunk has no such place, so it is told of them here. Nothing given is zero: the network then
    is the one without a prefix.

    Args:
        n_predictions: P, how many may be given.
        action_dim: A.
        dim: width of the token.
    """

    def __init__(self, n_predictions: int, action_dim: int, dim: int):
        super().__init__()
        self.n_predictions = n_predictions
        self.project = nn.Sequential(
            nn.Linear(n_predictions * (action_dim + 1), dim, bias=False),
            nn.GELU(),
            nn.Linear(dim, dim, bias=False),
        )

    def forward(self, prefix: GivenActions) -> Float[Tensor, "B D"]:
        """The vector; zero where nothing is given."""
        shown = torch.where(prefix.given[..., None], prefix.actions, 0.0)
        told = torch.cat((shown, prefix.given[..., None].to(shown)), dim=-1)
        return self.project(told.flatten(1))


def draw_prefix(
    chunk: Float[Tensor, "B T A"], n_predictions: int, generator: torch.Generator
) -> tuple[GivenActions, Bool[Tensor, "B T"]]:
    """Demonstrated first actions, as many as chance says: 0 to P of each sample alike often.

    Args:
        chunk: demonstrated actions.
        n_predictions: P.
        generator: source of chance.

    Returns:
        What is given, and which of the chunk's actions that is.
    """
    draw = partial(torch.randint, n_predictions + 1)
    n_given = draw_rows(draw, (len(chunk), 1), generator=generator, device=chunk.device)
    given = torch.arange(chunk.shape[1], device=chunk.device) < n_given
    return GivenActions(chunk[:, :n_predictions], given[:, :n_predictions]), given


def begun_with(prefix: GivenActions, chunk: Float[Tensor, "B T A"]) -> Float[Tensor, "B T A"]:
    """The chunk with its given actions in place, as far as it reaches."""
    n_common = min(chunk.shape[1], prefix.given.shape[1])
    given, actions = prefix.given[:, :n_common, None], prefix.actions[:, :n_common].to(chunk)
    return torch.cat((torch.where(given, actions, chunk[:, :n_common]), chunk[:, n_common:]), dim=1)
