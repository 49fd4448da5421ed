"""ACT's latent: standard normal, with an optional density fitted after training."""

import torch
from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.nn.buffers import keep_missing_buffers
from lerobot_act_chunking.nn.latents.latent import Latent, Posterior
from lerobot_act_chunking.nn.latents.normal import kl_to_standard_normal, sample_normal, select_component
from lerobot_act_chunking.nn.latents.spec import LatentSpec

MOST_COMPONENTS = 16
LOG_VARIANCE = (-10.0, 5.0)  # beyond, nothing is gained and exponentials may overflow


class GaussianLatent(Latent):
    """q(z | x) = N(mean, diagonal variance), trained towards N(0, I).

    The styles of the demonstrations rarely fill N(0, I) evenly: between them lie styles that no demonstration
    has taught (holes of the prior). `fit_density` replaces the distribution from which acting samples by a
    mixture that follows the encoded demonstrations (ex-post density estimation, Ghosh et al. 2020). Until
    then it is the mixture of one component, N(0, I). The mode is zero in both cases, as ACT acts.

    Args:
        dim: L.
        temperature: standard deviations are multiplied by it when sampling.
        uniform: sample all fitted components equally often, whatever their weights.
    """

    def __init__(self, dim: int, *, temperature: float = 1.0, uniform: bool = False):
        super().__init__()
        self.dim, self.n_parameters, self.n_noise = dim, 2 * dim, dim + 1
        self.temperature, self.uniform = temperature, uniform
        self.weights: Tensor
        self.means: Tensor
        self.scales: Tensor
        self.register_buffer("weights", torch.zeros(MOST_COMPONENTS))
        self.register_buffer("means", torch.zeros(MOST_COMPONENTS, dim))
        self.register_buffer("scales", torch.zeros(MOST_COMPONENTS, dim, dim))
        self.fit_density(torch.ones(1), torch.zeros(1, dim), torch.eye(dim)[None])
        self.register_load_state_dict_pre_hook(keep_missing_buffers)  # acts with N(0, I)

    @classmethod
    def from_spec(cls, spec: LatentSpec, token_dim: int) -> "GaussianLatent":
        """A fresh latent with these settings."""
        return cls(spec.latent_dim, temperature=spec.z_temperature, uniform=spec.uniform)

    @property
    def fitted(self) -> bool:
        """Whether acting samples another density than N(0, I)."""
        return bool(self.means.any()) or int((self.weights > 0).sum()) > 1

    def fit_density(
        self, weights: Float[Tensor, " M"], means: Float[Tensor, "M L"], scales: Float[Tensor, "M L L"]
    ) -> None:
        """Let acting sample from a mixture of at most `MOST_COMPONENTS` normal distributions.

        Args:
            weights: their shares.
            means: their centres.
            scales: lower triangular factors S of their covariances S Sᵀ.
        """
        for buffer, values in ((self.weights, weights), (self.means, means), (self.scales, scales)):
            buffer.zero_()
            buffer[: len(values)] = values

    def _posterior(
        self,
        parameters: Float[Tensor, "B P"],
        noise: Float[Tensor, "B n"],
        tokens: Float[Tensor, "B N D"],
    ) -> Posterior:
        mean, log_variance = split_normal(parameters)
        z = sample_normal(mean, log_variance, noise[:, : self.dim])
        return Posterior(z, kl_to_standard_normal(mean, log_variance), mean)

    def prior(
        self, noise: Float[Tensor, "B n"] | None, tokens: Float[Tensor, "B N D"]
    ) -> Float[Tensor, "B L"]:
        """Zero, or samples of the fitted density; the last noise number chooses the component."""
        if noise is None:
            return self.means.new_zeros(len(tokens), self.dim)
        weights = (self.weights > 0).float() if self.uniform else self.weights
        chosen = select_component(weights, noise[:, -1])
        spread = torch.einsum("bm,mij,bj->bi", chosen, self.scales, noise[:, : self.dim])
        return chosen @ self.means + self.temperature * spread


def split_normal(
    parameters: Float[Tensor, "B P"],
) -> tuple[Float[Tensor, "B L"], Float[Tensor, "B L"]]:
    """Mean and log-variance of a posterior, the latter within `LOG_VARIANCE`."""
    mean, log_variance = parameters.chunk(2, dim=-1)
    return mean, log_variance.clamp(*LOG_VARIANCE)
