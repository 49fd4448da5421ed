"""A latent that is one of M codes: styles that cannot blend."""

import torch
from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.nn.latents.latent import Latent, Posterior
from lerobot_act_chunking.nn.latents.normal import select_component
from lerobot_act_chunking.nn.latents.spec import LatentSpec
from lerobot_act_chunking.nn.processes import mean_over_processes

FIRST_TEMPERATURE, LAST_TEMPERATURE = 1.0, 0.3
USAGE_RATE = 0.01  # of the moving average over training batches
LOGIT_SCALE = 10.0
LEAST_USAGE = 0.04  # of an equal share; codes below it decode to nothing that was demonstrated


class CategoricalLatent(Latent):
    """q(z | x) over M codes, trained towards equal use; z is one-hot.

    Training samples with the straight-through Gumbel-softmax (Jang et al. 2017): the sample is one-hot, its
    gradient that of the relaxation, whose temperature falls. Acting samples among the codes that training
    uses: the others would decode to anything.

    Logits are scaled up, so that demonstrations begin with codes of their own: with codes that are little
    more than noise, the decoder would learn to do without them before they say anything.

    Args:
        n_codes: M, also the width of z.
        anneal_steps: training steps over which the relaxation's temperature falls from 1 to 0.3.
        temperature: when acting, shares of codes count with the power 1 / temperature.
        uniform: act with all used codes equally often, whatever their share.
    """

    def __init__(self, n_codes: int, *, anneal_steps: int, temperature: float = 1.0, uniform: bool = False):
        super().__init__()
        self.dim = self.n_parameters = self.n_noise = n_codes
        self.anneal_steps, self.temperature, self.uniform = anneal_steps, temperature, uniform
        self.usage: Tensor
        self.n_steps: Tensor
        self.register_buffer("usage", torch.full((n_codes,), 1 / n_codes))
        self.register_buffer("n_steps", torch.tensor(0))

    @classmethod
    def from_spec(cls, spec: LatentSpec, token_dim: int) -> "CategoricalLatent":
        """A fresh latent with these settings."""
        return cls(
            spec.n_latent_components,
            anneal_steps=spec.latent_warmup_steps,
            temperature=spec.z_temperature,
            uniform=spec.uniform,
        )

    @property
    def relaxation(self) -> Float[Tensor, ""]:
        """Temperature of the Gumbel-softmax at this step of the training."""
        progress = (self.n_steps / self.anneal_steps).clamp_max(1)
        return FIRST_TEMPERATURE + (LAST_TEMPERATURE - FIRST_TEMPERATURE) * progress

    def _posterior(
        self,
        parameters: Float[Tensor, "B P"],
        noise: Float[Tensor, "B n"],
        tokens: Float[Tensor, "B N D"],
    ) -> Posterior:
        log_q = (LOGIT_SCALE * parameters).log_softmax(-1)
        q = log_q.exp()
        relaxed = ((log_q + _gumbel(noise)) / self.relaxation).softmax(-1)
        hard = _one_hot(relaxed)
        if self.training:
            self.n_steps += 1
            self.usage.lerp_(mean_over_processes(q.detach().mean(0)).to(self.usage), USAGE_RATE)
        divergence = (q * (log_q - log_q.new_tensor(1 / self.dim).log())).sum(-1, keepdim=True)
        return Posterior(hard + relaxed - relaxed.detach(), divergence, q)

    def prior(
        self, noise: Float[Tensor, "B n"] | None, tokens: Float[Tensor, "B N D"]
    ) -> Float[Tensor, "B L"]:
        """The code used most, or samples among the used ones."""
        if noise is None:
            return _one_hot(self.usage).expand(len(tokens), -1)
        used = self.usage >= LEAST_USAGE / self.dim
        weights = used.float() if self.uniform else used * self.usage ** (1 / self.temperature)
        return select_component(weights, noise[:, 0])


def _gumbel(noise: Float[Tensor, "B M"]) -> Float[Tensor, "B M"]:
    """Gumbel noise from standard normal noise: -log(-log(Phi(noise)))."""
    return -(-torch.special.log_ndtr(noise)).log()


def _one_hot(scores: Float[Tensor, "*B M"]) -> Float[Tensor, "*B M"]:
    return torch.nn.functional.one_hot(scores.argmax(-1), scores.shape[-1]).to(scores.dtype)
