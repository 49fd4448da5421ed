"""The random draws of training, which a resumed run goes on with."""

from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from lerobot_act_chunking.nn.processes import draw_rows
from lerobot_act_chunking.policies.batch_seeds import BatchSeeds
from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)
from lerobot_act_chunking.sampling.process import Process


@dataclass(frozen=True)
class Draws:
    """What chance decides about a batch.

    Attributes:
        time: noise levels.
        noise: mixed into the actions.
        prefix: actions that the network is given as they are; None without prefix conditioning.
        drop: samples of which is left out what guidance may leave out; None without guidance.
    """

    time: Float[Tensor, " B"]
    noise: Float[Tensor, "B T A"]
    prefix: Bool[Tensor, "B T"] | None = None
    drop: Bool[Tensor, " B"] | None = None


class TrainingNoise(BatchSeeds):
    """What is drawn for each batch, from a generator of its own."""

    def __init__(self, config: DiffusionChunkedConfig, process: Process):
        super().__init__()
        self.config = config
        self.process = process

    def forward(self, actions: Float[Tensor, "B T A"]) -> Draws:
        """The draws for the next batch."""
        generator = self.next_generator(actions.device)
        return Draws(
            time=draw_rows(
                lambda shape: self.process.draw_times(shape[0], actions, generator), (len(actions),)
            ),
            noise=draw_rows(
                torch.randn, actions.shape, generator=generator, device=actions.device, dtype=actions.dtype
            ),
            prefix=self._prefix(actions, generator) if self.config.prefix_steps else None,
            drop=self._drop(actions, generator) if self.config.dropout_of_left_out else None,
        )

    def _prefix(self, actions: Float[Tensor, "B T A"], generator: torch.Generator) -> Bool[Tensor, "B T"]:
        """As many first tokens as chance says, up to `prefix_tokens`."""
        device, longest = actions.device, self.config.prefix_tokens
        draw = partial(torch.randint, longest + 1)
        n_tokens = draw_rows(draw, (len(actions), 1), generator=generator, device=device)
        steps = torch.arange(actions.shape[1], device=device)
        return steps < n_tokens * self.config.actions_per_token

    def _drop(self, actions: Float[Tensor, "B T A"], generator: torch.Generator) -> Bool[Tensor, " B"] | None:
        """A share ``condition_dropout`` or ``language_dropout`` of the samples; none in evaluation."""
        if not self.training:
            return None
        drawn = draw_rows(torch.rand, (len(actions),), generator=generator, device=actions.device)
        return drawn < self.config.dropout_of_left_out
