"""How `act_chunked` learns its latent, and what it says about it."""

import torch
from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.nn.buffers import CountsOnCpu, keep_missing_buffers
from lerobot_act_chunking.nn.kl import KlSchedule, free_bits
from lerobot_act_chunking.nn.latents.health import latent_metrics
from lerobot_act_chunking.nn.processes import draw_rows
from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig
from lerobot_act_chunking.policies.act_chunked.network import ActNetwork, TrainingBatch

PRIOR_EVERY = 100  # training batches between two evaluations with the prior


class VaeLoss(CountsOnCpu):
    """The loss of a policy with a latent: action loss + weight * KL (ACT, Zhao et al. 2023, section IV-C).

    In training mode the actions are decoded from the style that they show (the posterior), in evaluation mode
    from the one that the policy acts with (the prior). Logged are

    - the loss of the actions, and with ``_prior`` or ``_posterior`` behind its name that of the other kind
      (in training every hundredth batch): the difference is what acting lacks;
    - ``kld_loss``, the divergence [nats], and the health of the latent (`latent_metrics`).
    """

    counts = ("n_updates",)

    def __init__(self, config: ActChunkedConfig):
        super().__init__()
        self.config = config
        self.schedule = KlSchedule(config.kl_anneal, config.kl_anneal_steps)
        self.n_updates: Tensor
        self.register_buffer("n_updates", torch.tensor(0))
        self.register_load_state_dict_pre_hook(keep_missing_buffers)
        self._n_batches = 0
        self._prior_loss: Tensor | None = None

    def advance(self) -> None:
        """An optimiser step has been taken."""
        self.n_updates += 1

    def forward(
        self, network: ActNetwork, batch: TrainingBatch, generator: torch.Generator
    ) -> tuple[Float[Tensor, " B"], dict[str, Tensor]]:
        """Loss of each sample, and what is logged."""
        config, name = self.config, self.config.loss_name
        posterior = network.posterior(batch, _noise(network, batch, generator))
        terms = {"kld_loss": posterior.divergence.sum(-1).mean()}
        terms |= latent_metrics(posterior.mean, posterior.divergence)
        found = network.loss(batch, posterior.z, config.pad_normalization)
        if not self.training:
            prior = network.prior(batch.observation, self._acting_noise(network, batch, generator))
            loss = network.loss(batch, prior, config.pad_normalization)
            return loss, {name: loss.mean(), f"{name}_posterior": found.mean(), **terms}
        terms |= {name: found.mean(), f"{name}_prior": self._acting_loss(network, batch, generator)}
        weight = config.kl_weight * self.schedule(int(self.n_updates))
        return found + weight * free_bits(posterior.divergence, config.free_bits), terms

    @torch.no_grad()
    def _acting_loss(self, network: ActNetwork, batch: TrainingBatch, generator: torch.Generator) -> Tensor:
        """The loss with the latent that the policy acts with, from the latest batch in which it was due."""
        if self._prior_loss is None or self._n_batches % PRIOR_EVERY == 0:
            network.eval()  # no gradient, no dropout
            prior = network.prior(batch.observation, self._acting_noise(network, batch, generator))
            self._prior_loss = network.loss(batch, prior, self.config.pad_normalization).mean()
            network.train()
        self._n_batches += 1
        return self._prior_loss

    def _acting_noise(
        self, network: ActNetwork, batch: TrainingBatch, generator: torch.Generator
    ) -> Float[Tensor, "B n"] | None:
        return _noise(network, batch, generator) if self.config.z_inference == "sample" else None


def _noise(network: ActNetwork, batch: TrainingBatch, generator: torch.Generator) -> Float[Tensor, "B n"]:
    """Standard normal numbers for one latent of each sample."""
    assert network.latent is not None  # noqa: S101
    tokens = batch.observation.tokens
    shape = (len(tokens), network.latent.n_noise)
    return draw_rows(torch.randn, shape, generator=generator, device=tokens.device, dtype=tokens.dtype)
