"""Actions with a Laplace distribution around the prediction: L1 with a learned scale."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.heads.action_head import ElementHead
from lerobot_act_chunking.heads.action_scale import BoundedScale, open_interval
from lerobot_act_chunking.heads.spec import HeadSize, HeadSpec


class LaplaceHead(ElementHead):
    """Location mu and scale b of every element, scored by their negative log-likelihood.

    ``|a - mu| / b + log 2b`` is L1 weighted by how sure the network is, which neglects what it predicts
    badly. Times ``b^(2 beta)``, held constant in the gradient as in beta-NLL (Seitzer et al. 2022), the
    pull on mu is that of the likelihood at beta 0 and that of L1 at 0.5. Samples have density ``p^(1/tau)``,
    a Laplace one of scale ``tau b``.

    Args:
        dim: width D of features.
        action_dim: A.
        actions_per_query: consecutive actions of each query.
        n_queries: Q.
        beta: in [0, 1].
        min_std: least standard deviation, sqrt(2) b, in normalised action units.
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
        self.scale = BoundedScale(min_std / math.sqrt(2))
        self.beta = beta
        self.temperature = temperature
        if temperature > 0:
            self.draws_shape = (n_queries * actions_per_query, action_dim)

    @classmethod
    def from_spec(cls, spec: HeadSpec, size: HeadSize) -> "LaplaceHead":
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
        """Negative log-likelihood of each element [nats], times ``b^(2 beta)``."""
        location, raw = self.parameters_of(features).unbind(-1)
        log_scale = self.scale.log(raw)
        loss = (actions - location).abs() * (-log_scale).exp() + log_scale + math.log(2)
        return loss * (2 * self.beta * log_scale.detach()).exp() if self.beta else loss

    def choose(
        self, features: Float[Tensor, "B q D"], draws: Float[Tensor, "B t A"] | None
    ) -> Float[Tensor, "B t A"]:
        """The locations, or samples by inverse transform."""
        location, raw = self.parameters_of(features).unbind(-1)
        if draws is None:
            return location
        centred = open_interval(draws.to(location)) - 0.5
        magnitude = -torch.log1p(-2 * centred.abs())
        return location + self.temperature * self.scale.log(raw).exp() * centred.sign() * magnitude
