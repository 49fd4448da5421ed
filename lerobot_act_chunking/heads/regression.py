"""Direct regression of the actions."""

from jaxtyping import Float
from torch import Tensor, nn


class RegressionHead(nn.Module):
    """One linear layer from query features to actions, scored by the absolute error (ACT's L1).

    Each query may emit several consecutive actions: a chunk of T steps then needs only T /
    ``actions_per_query`` queries, which are most of the cost of a small policy.
    """

    def __init__(self, dim: int, action_dim: int, actions_per_query: int):
        super().__init__()
        self.actions_per_query = actions_per_query
        self.projection = nn.Linear(dim, actions_per_query * action_dim)

    def forward(self, features: Float[Tensor, "B Q D"]) -> Float[Tensor, "B T A"]:
        """Actions of every step, in order."""
        return self.projection(features).unflatten(-1, (self.actions_per_query, -1)).flatten(1, 2)

    def error(
        self, predicted: Float[Tensor, "B T A"], target: Float[Tensor, "B T A"]
    ) -> Float[Tensor, "B T A"]:
        """Error of each action element, in normalised action units."""
        return (predicted - target).abs()
