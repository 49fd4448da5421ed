"""Direct regression of the actions."""

from typing import Literal

from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.heads.action_head import ElementHead, at_least_single
from lerobot_act_chunking.heads.spec import HeadSize, HeadSpec


class RegressionHead(ElementHead):
    """One linear layer from query features to actions, scored by their absolute or squared error.

    Where demonstrations differ, the absolute error (ACT's) finds the median of each element, that of the
    majority's way; the squared error the mean, which may be nobody's.

    Args:
        dim: width D of features.
        action_dim: A.
        actions_per_query: consecutive actions of each query.
        power: of the error.
    """

    def __init__(self, dim: int, action_dim: int, actions_per_query: int, power: Literal[1, 2] = 1):
        super().__init__(dim, action_dim, actions_per_query, n_parameters=1)
        self.power = power

    @classmethod
    def from_spec(cls, spec: HeadSpec, size: HeadSize) -> "RegressionHead":
        """A fresh head with these settings."""
        return cls(*size.layer, power=1 if spec.action_likelihood == "l1" else 2)

    @classmethod
    def check(cls, spec: HeadSpec) -> None:
        """Refuse to sample what is predicted without a distribution.

        Raises:
            ConfigurationError: naming the value and the way out.
        """
        if spec.action_temperature:
            raise ConfigurationError(
                f"action_temperature={spec.action_temperature}, but {spec.action_likelihood} predicts one "
                "action and has nothing to sample: set action_temperature=0, or action_likelihood=gaussian"
            )

    def forward(self, features: Float[Tensor, "B q D"]) -> Float[Tensor, "B t A"]:
        """Actions of every step, in order."""
        return self.projection(features).unflatten(-1, (self.actions_per_query, -1)).flatten(1, 2)

    def element_loss(
        self, features: Float[Tensor, "B Q D"], actions: Float[Tensor, "B T A"]
    ) -> Float[Tensor, "B T A"]:
        """Error of each element, in normalised action units (squared with ``power`` 2)."""
        difference = self(features) - actions
        return difference.abs() if self.power == 1 else difference.square()

    def choose(self, features: Float[Tensor, "B q D"], draws: Tensor | None) -> Float[Tensor, "B t A"]:
        """The prediction, in single precision at least, also under autocast."""
        return at_least_single(self(features))
