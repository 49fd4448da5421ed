"""A latent whose prior is a learned mixture: one component for each way of acting."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.buffers import CountsOnCpu
from lerobot_act_chunking.nn.latents.gaussian import LOG_VARIANCE, split_normal
from lerobot_act_chunking.nn.latents.latent import Latent, Posterior
from lerobot_act_chunking.nn.latents.normal import (
    kl_to_standard_normal,
    log_density,
    sample_normal,
    select_component,
)
from lerobot_act_chunking.nn.latents.spec import LatentSpec
from lerobot_act_chunking.nn.processes import all_rows

N_REMEMBERED = 1024  # encodings that place the components
SPREAD_RATE = 0.05  # of the moving average of posterior variances


class MixtureLatent(CountsOnCpu, Latent):
    """p(z) = sum of w_m N(mean_m, diagonal variance_m).

    Components that start at random places do not find the ways of acting. The prior therefore is N(0, I) for
    the first training steps; k-means over the latest encodings then places the components, which learn from
    there on. The divergence is the estimate log q(z|x) - log p(z) at the one sample z, for all dimensions
    together; there is no closed form.

    Args:
        dim: L.
        n_components: M.
        warmup_steps: training steps until the components are placed.
        temperature: standard deviations are multiplied by it when sampling.
        uniform: fixed equal weights in place of learned ones.
    """

    counts = ("n_seen", "n_steps")

    def __init__(
        self,
        dim: int,
        n_components: int,
        *,
        warmup_steps: int,
        temperature: float = 1.0,
        uniform: bool = False,
    ):
        super().__init__()
        self.dim, self.n_parameters, self.n_noise = dim, 2 * dim, dim + 1
        self.warmup_steps, self.temperature = warmup_steps, temperature
        self.means = nn.Parameter(torch.zeros(n_components, dim))
        self.log_variances = nn.Parameter(torch.zeros(n_components, dim))
        self.logits = nn.Parameter(torch.zeros(n_components), requires_grad=not uniform)
        self.remembered: Tensor
        self.spread: Tensor
        self.n_seen: Tensor
        self.n_steps: Tensor
        self.register_buffer("remembered", torch.zeros(N_REMEMBERED, dim))
        self.register_buffer("spread", torch.ones(dim))
        self.register_buffer("n_seen", torch.tensor(0))
        self.register_buffer("n_steps", torch.tensor(0))

    @classmethod
    def from_spec(cls, spec: LatentSpec, token_dim: int) -> "MixtureLatent":
        """A fresh latent with these settings."""
        return cls(
            spec.latent_dim,
            spec.n_latent_components,
            warmup_steps=spec.latent_warmup_steps,
            temperature=spec.z_temperature,
            uniform=spec.uniform,
        )

    @property
    def placed(self) -> bool:
        """Whether the components are in use."""
        return int(self.n_steps) > self.warmup_steps

    def _posterior(
        self,
        parameters: Float[Tensor, "B P"],
        noise: Float[Tensor, "B n"],
        tokens: Float[Tensor, "B N D"],
    ) -> Posterior:
        mean, log_variance = split_normal(parameters)
        if self.training:
            self._learn_places(mean.detach(), log_variance.detach())
        z = sample_normal(mean, log_variance, noise[:, : self.dim])
        if not self.placed:
            return Posterior(z, kl_to_standard_normal(mean, log_variance).sum(-1, keepdim=True), mean)
        divergence = log_density(z, mean, log_variance) - self.log_prior(z)
        return Posterior(z, divergence[:, None], mean)

    def prior(
        self, noise: Float[Tensor, "B n"] | None, tokens: Float[Tensor, "B N D"]
    ) -> Float[Tensor, "B L"]:
        """The highest peak, or samples; the last noise number chooses the component."""
        if not self.placed:
            mode = self.means.new_zeros(len(tokens), self.dim)
            return mode if noise is None else self.temperature * noise[:, : self.dim]
        if noise is None:
            peak = (self.logits - self._log_variances.sum(-1) / 2).argmax()
            return self.means[peak].expand(len(tokens), -1)
        chosen = select_component(self.logits.softmax(-1), noise[:, -1])
        scaled = self.temperature * noise[:, : self.dim]
        return sample_normal(chosen @ self.means, chosen @ self._log_variances, scaled)

    def log_prior(self, z: Float[Tensor, "B L"]) -> Float[Tensor, " B"]:
        """Logarithm of the mixture's density [nats]."""
        by_component = log_density(z[:, None], self.means, self._log_variances)
        return (self.logits.log_softmax(-1) + by_component).logsumexp(-1)

    @property
    def _log_variances(self) -> Float[Tensor, "M L"]:
        return self.log_variances.clamp(*LOG_VARIANCE)

    @torch.no_grad()
    def _learn_places(self, mean: Float[Tensor, "B L"], log_variance: Float[Tensor, "B L"]) -> None:
        """Remember encodings until the warm-up is over, then place the components.

        All processes of a run remember the encodings of all: they must agree on the parameters.
        """
        mean, log_variance = all_rows(mean), all_rows(log_variance)
        step = int(self.n_steps)
        self.n_steps += 1
        if step > self.warmup_steps:
            return
        if step == self.warmup_steps:
            self._place()
        rows = torch.arange(int(self.n_seen), int(self.n_seen) + len(mean), device=mean.device)
        self.remembered[rows % N_REMEMBERED] = mean.to(self.remembered)
        self.n_seen += len(mean)
        self.spread.lerp_(log_variance.exp().mean(0).to(self.spread), SPREAD_RATE)

    def _place(self) -> None:
        """Put the components on the clusters of the remembered encodings (k-means, Lloyd 1982)."""
        from sklearn.cluster import KMeans  # only here: importing it takes a second

        seen = self.remembered[: int(self.n_seen)].double().cpu()
        n_clusters = min(len(self.means), len(seen))
        found = KMeans(n_clusters, n_init=4, random_state=0).fit(seen.numpy())  # pyright: ignore[reportArgumentType]
        label = torch.nn.functional.one_hot(torch.as_tensor(found.labels_).long(), n_clusters).double()
        share = label.mean(0)
        centres = torch.as_tensor(found.cluster_centers_)
        squares = (label.T @ seen.square()) / label.sum(0)[:, None]
        variances = (squares - centres.square()).clamp_min(0) + self.spread.double().cpu()
        self.means[:n_clusters] = centres.to(self.means)
        self.log_variances[:n_clusters] = variances.log().to(self.log_variances)
        if self.logits.requires_grad:
            self.logits[:n_clusters] = share.log().to(self.logits)
