"""The random draws of training, which a resumed run goes on with."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)
from lerobot_act_chunking.sampling.process import Process

EVALUATION_SEED = 0


@dataclass(frozen=True)
class Draws:
    """What chance decides about a batch.

    Attributes:
        time: noise levels.
        noise: mixed into the actions.
        prefix: actions that the network is given as they are; None without prefix conditioning.
        drop: samples whose ``guidance_features`` are left out; None without guidance.
    """

    time: Float[Tensor, " B"]
    noise: Float[Tensor, "B T A"]
    prefix: Bool[Tensor, "B T"] | None = None
    drop: Bool[Tensor, " B"] | None = None


class TrainingNoise(nn.Module):
    """A generator for every batch, whose seed follows from the run and the number of batches before it.

    Both are saved with the weights. LeRobot restores PyTorch's global generator on resuming, too, but its new
    data loader draws from it before the policy can. In evaluation mode every batch gets the same draws:
    losses of different checkpoints then differ by their weights alone.
    """

    def __init__(self, config: DiffusionChunkedConfig, process: Process):
        super().__init__()
        self.config = config
        self.process = process
        self.seed: Tensor
        self.n_batches: Tensor
        self.register_buffer("seed", torch.tensor(-1))  # drawn from the global generator on first use
        self.register_buffer("n_batches", torch.tensor(0))

    def forward(self, actions: Float[Tensor, "B T A"]) -> Draws:
        """The draws for the next batch."""
        generator = self._next_generator(actions.device)
        return Draws(
            time=self.process.draw_times(len(actions), actions, generator),
            noise=torch.randn(actions.shape, generator=generator, device=actions.device, dtype=actions.dtype),
            prefix=self._prefix(actions, generator) if self.config.prefix_steps else None,
            drop=self._drop(actions, generator) if self.config.condition_dropout else None,
        )

    def _next_generator(self, device: torch.device) -> torch.Generator:
        """The generator of the next batch; ranks of a distributed run have different ones."""
        if not self.training:
            return torch.Generator(device).manual_seed(EVALUATION_SEED)
        if self.seed < 0:
            self.seed.fill_(int(torch.randint(2**62, ())))
        distributed = torch.distributed.is_available() and torch.distributed.is_initialized()
        rank = torch.distributed.get_rank() if distributed else 0
        entropy = (int(self.seed), int(self.n_batches), rank)
        self.n_batches += 1
        return torch.Generator(device).manual_seed(
            int(np.random.SeedSequence(entropy).generate_state(1, np.uint64)[0])
        )

    def _prefix(self, actions: Float[Tensor, "B T A"], generator: torch.Generator) -> Bool[Tensor, "B T"]:
        """As many first tokens as chance says, up to `prefix_tokens`."""
        device, longest = actions.device, self.config.prefix_tokens
        n_tokens = torch.randint(longest + 1, (len(actions), 1), generator=generator, device=device)
        steps = torch.arange(actions.shape[1], device=device)
        return steps < n_tokens * self.config.actions_per_token

    def _drop(self, actions: Float[Tensor, "B T A"], generator: torch.Generator) -> Bool[Tensor, " B"] | None:
        """A share ``condition_dropout`` of the samples; none in evaluation."""
        if not self.training:
            return None
        drawn = torch.rand(len(actions), generator=generator, device=actions.device)
        return drawn < self.config.condition_dropout
