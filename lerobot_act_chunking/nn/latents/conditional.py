"""A latent whose prior depends on what is observed, for tasks in which the ways of acting do."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.latents.gaussian import split_normal
from lerobot_act_chunking.nn.latents.latent import Latent, Posterior
from lerobot_act_chunking.nn.latents.normal import kl_between_normals, sample_normal
from lerobot_act_chunking.nn.latents.spec import LatentSpec


class ConditionalLatent(Latent):
    """p(z | o) = N(mean(o), diagonal variance(o)), learned with the policy (Sohn et al. 2015, section 4).

    A small network reads the mean of the observation tokens; it starts as N(0, I).

    Args:
        dim: L.
        token_dim: D.
        temperature: standard deviations are multiplied by it when sampling.
    """

    def __init__(self, dim: int, token_dim: int, *, temperature: float = 1.0):
        super().__init__()
        self.dim, self.n_parameters, self.n_noise = dim, 2 * dim, dim
        self.temperature = temperature
        last = nn.Linear(token_dim, 2 * dim)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.predict = nn.Sequential(
            nn.LayerNorm(token_dim), nn.Linear(token_dim, token_dim), nn.GELU(), last
        )

    @classmethod
    def from_spec(cls, spec: LatentSpec, token_dim: int) -> "ConditionalLatent":
        """A fresh latent with these settings."""
        return cls(spec.latent_dim, token_dim, temperature=spec.z_temperature)

    def _posterior(
        self,
        parameters: Float[Tensor, "B P"],
        noise: Float[Tensor, "B n"],
        tokens: Float[Tensor, "B N D"],
    ) -> Posterior:
        mean, log_variance = split_normal(parameters)
        divergence = kl_between_normals(mean, log_variance, *self._prior_normal(tokens))
        return Posterior(sample_normal(mean, log_variance, noise), divergence, mean)

    def prior(
        self, noise: Float[Tensor, "B n"] | None, tokens: Float[Tensor, "B N D"]
    ) -> Float[Tensor, "B L"]:
        """The prior's mean, or samples around it."""
        mean, log_variance = self._prior_normal(tokens)
        return mean if noise is None else sample_normal(mean, log_variance, self.temperature * noise)

    def _prior_normal(
        self, tokens: Float[Tensor, "B N D"]
    ) -> tuple[Float[Tensor, "B L"], Float[Tensor, "B L"]]:
        parameters = self.predict(tokens.mean(1))
        return split_normal(parameters.to(torch.promote_types(parameters.dtype, torch.float32)))
