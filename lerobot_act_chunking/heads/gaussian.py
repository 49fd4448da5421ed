"""Actions with a normal distribution around the prediction: L2 with a learned scale."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.heads.action_head import ElementHead
from lerobot_act_chunking.heads.action_scale import BoundedScale, open_interval
from lerobot_act_chunking.heads.spec import HeadSize, HeadSpec

HALF_LOG_TAU = 0.5 * math.log(math.tau)


class GaussianHead(ElementHead):
    """Mean mu and standard deviation sigma of every element, scored by beta-NLL (Seitzer et al. 2022, eq. 5).

    The negative log-likelihood pulls the mean with 1 / sigma^2 and so neglects what it predicts badly. Times
    ``sigma^(2 beta)``, held constant in the gradient, the pull is that of the squared error at beta 1 and
    that of the likelihood at 0. Samples have density ``p^(1/tau)``, a normal one of ``sqrt(tau) sigma``.

    Args:
        dim: width D of features.
        action_dim: A.
        actions_per_query: consecutive actions of each query.
        n_queries: Q.
        beta: in [0, 1].
        min_std: least sigma, in normalised action units.
        temperature: tau; 0 takes mu.
    """

    def __init__(
        self,
        dim: int,
        action_dim: int,
        actions_per_query: int,
        *,
        n_queries: int,
        beta: float,
        min_std: float,
        temperature: float,
    ):
        super().__init__(dim, action_dim, actions_per_query, n_parameters=2)
        self.scale = BoundedScale(min_std)
        self.beta = beta
        self.temperature = temperature
        if temperature > 0:
            self.draws_shape = (n_queries * actions_per_query, action_dim)

    @classmethod
    def from_spec(cls, spec: HeadSpec, size: HeadSize) -> "GaussianHead":
        """A fresh head with these settings."""
        return cls(
            *size.layer,
            n_queries=size.n_queries,
            beta=spec.nll_beta,
            min_std=spec.min_std,
            temperature=spec.action_temperature,
        )

    def element_loss(
        self, features: Float[Tensor, "B Q D"], actions: Float[Tensor, "B T A"]
    ) -> Float[Tensor, "B T A"]:
        """Negative log-likelihood of each element [nats], times ``sigma^(2 beta)``."""
        mean, raw = self.parameters_of(features).unbind(-1)
        log_std = self.scale.log(raw)
        loss = normal_nll(actions, mean, log_std)
        return loss * (2 * self.beta * log_std.detach()).exp() if self.beta else loss

    def choose(
        self, features: Float[Tensor, "B q D"], draws: Float[Tensor, "B t A"] | None
    ) -> Float[Tensor, "B t A"]:
        """The means, or samples by inverse transform."""
        mean, raw = self.parameters_of(features).unbind(-1)
        if draws is None:
            return mean
        normal = torch.special.ndtri(open_interval(draws.to(mean)))
        return mean + math.sqrt(self.temperature) * self.scale.log(raw).exp() * normal


def mean_with_scaled_gradient(
    mean: Float[Tensor, "*S"], log_std: Float[Tensor, "*S"], beta: float
) -> Float[Tensor, "*S"]:
    """The same means, whose gradient is multiplied by ``sigma^(2 beta)``: beta-NLL's pull on them alone.

    For losses whose value must stay that of the likelihood.
    """
    pull = (2 * beta * log_std.detach()).exp()
    return mean.detach() + pull * (mean - mean.detach())


def normal_nll(
    actions: Float[Tensor, "*#S"], mean: Float[Tensor, "*S"], log_std: Float[Tensor, "*S"]
) -> Float[Tensor, "*S"]:
    """Negative log-likelihood [nats] of each action under its normal distribution."""
    return 0.5 * ((actions - mean) * (-log_std).exp()).square() + log_std + HALF_LOG_TAU
