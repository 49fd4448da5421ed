"""What every action head does: score demonstrated actions, and choose actions, given query features."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from lerobot_act_chunking.heads.spec import HeadSize, HeadSpec
from lerobot_act_chunking.nn.masking import PadNormalization, per_sample_error

Act = Callable[[Float[Tensor, "B q D"]], Float[Tensor, "B t A"]]


class ActionHead(nn.Module, ABC):
    """Normalised actions from the features of action queries, each of which stands for several steps.

    A chunk of T steps has Q = T / ``actions_per_query`` queries, which are most of the cost of a small
    policy.

    Attributes:
        is_bounded: whether it only predicts actions in [-1, 1].
        actions_per_query: consecutive actions of each query.
        draws_shape: shape of the uniform numbers that choosing one chunk consumes; () if nothing is random.
    """

    is_bounded: ClassVar[bool] = False
    actions_per_query: int
    draws_shape: tuple[int, ...] = ()

    @classmethod
    @abstractmethod
    def from_spec(cls, spec: HeadSpec, size: HeadSize) -> "ActionHead":
        """A fresh head with these settings."""

    @classmethod
    def check(cls, spec: HeadSpec) -> None:
        """Refuse settings that do not go with this head.

        Raises:
            ConfigurationError: naming the value and the way out.
        """

    def loss(
        self,
        features: Float[Tensor, "B Q D"],
        actions: Float[Tensor, "B T A"],
        is_pad: Bool[Tensor, "B T"],
        normalization: PadNormalization,
    ) -> Float[Tensor, " B"]:
        """Loss of each chunk, whose mean over the batch is the batch loss; see `per_sample_error`.

        Nothing of what padded steps hold, NaN included, reaches the loss or its gradient.
        """
        return self._loss(features, actions.masked_fill(is_pad[..., None], 0), is_pad, normalization)

    @abstractmethod
    def _loss(
        self,
        features: Float[Tensor, "B Q D"],
        actions: Float[Tensor, "B T A"],
        is_pad: Bool[Tensor, "B T"],
        normalization: PadNormalization,
    ) -> Float[Tensor, " B"]:
        """The loss, given actions without anything in the padding."""

    def actor(self, draws: Float[Tensor, "B *S"] | None = None) -> Act:
        """What turns the features of consecutive queries of one chunk into its actions.

        It may be called once with all queries or several times with some: what is chosen once per chunk, it
        keeps.

        Args:
            draws: uniform numbers in [0, 1), of shape ``draws_shape`` for each chunk; None if that is ().

        Raises:
            ValueError: draws that are missing or of another shape.
        """
        shape = () if draws is None else tuple(draws.shape[1:])
        if shape != self.draws_shape:
            raise ValueError(f"draws of shape {shape} for each chunk, but this head needs {self.draws_shape}")
        return self._actor(draws)

    @abstractmethod
    def _actor(self, draws: Float[Tensor, "B *S"] | None) -> Act:
        """The actor of one chunk, given draws of the right shape."""


class ElementHead(ActionHead):
    """A head that treats every element of an action by itself, given the features.

    One linear layer, ``projection``, gives each its ``n_parameters`` numbers.

    Args:
        dim: width D of features.
        action_dim: A.
        actions_per_query: consecutive actions of each query.
        n_parameters: P.
    """

    def __init__(self, dim: int, action_dim: int, actions_per_query: int, n_parameters: int):
        super().__init__()
        self.actions_per_query = actions_per_query
        self.parameter_shape = (actions_per_query, action_dim, n_parameters)
        self.projection = nn.Linear(dim, actions_per_query * action_dim * n_parameters)

    def parameters_of(self, features: Float[Tensor, "B q D"]) -> Float[Tensor, "B t A P"]:
        """The numbers of each element, in single precision at least, also under autocast."""
        return at_least_single(self.projection(features)).unflatten(-1, self.parameter_shape).flatten(1, 2)

    @abstractmethod
    def element_loss(
        self, features: Float[Tensor, "B Q D"], actions: Float[Tensor, "B T A"]
    ) -> Float[Tensor, "B T A"]:
        """Loss of each element."""

    @abstractmethod
    def choose(
        self, features: Float[Tensor, "B q D"], draws: Float[Tensor, "B t A"] | None
    ) -> Float[Tensor, "B t A"]:
        """Actions of these queries; ``draws`` are their uniform numbers, if the head needs any."""

    def _loss(
        self,
        features: Float[Tensor, "B Q D"],
        actions: Float[Tensor, "B T A"],
        is_pad: Bool[Tensor, "B T"],
        normalization: PadNormalization,
    ) -> Float[Tensor, " B"]:
        return per_sample_error(self.element_loss(features, actions), is_pad, normalization)

    def _actor(self, draws: Float[Tensor, "B T A"] | None) -> Act:
        n_done = 0

        def act(features: Float[Tensor, "B q D"]) -> Float[Tensor, "B t A"]:
            nonlocal n_done
            first, n_done = n_done, n_done + features.shape[1] * self.actions_per_query
            return self.choose(features, None if draws is None else draws[:, first:n_done])

        return act


def at_least_single(values: Float[Tensor, "*S"]) -> Float[Tensor, "*S"]:
    """Half precision as single precision; others as they are."""
    return values.to(torch.promote_types(values.dtype, torch.float32))
