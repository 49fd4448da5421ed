"""How strongly a latent is pulled to its prior, over training and over its dimensions."""

from dataclasses import dataclass
from typing import Literal

from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.nn.processes import mean_over_processes

KlAnneal = Literal["none", "linear", "cyclical"]
N_CYCLES = 4
RISING_SHARE = 0.5  # of a cycle; the weight is 1 for the rest


@dataclass(frozen=True)
class KlSchedule:
    """A factor of the divergence's weight that starts at zero, so that the latent is learned first.

    Attributes:
        kind: ``none``: 1 throughout; ``linear``: rises to 1 over ``n_steps``; ``cyclical``: rises four times
            within ``n_steps``, each time over half of the cycle (Fu et al. 2019, eq. 6-7). 1 afterwards.
        n_steps: training steps.
    """

    kind: KlAnneal
    n_steps: int

    def __call__(self, step: int) -> float:
        """The factor in [0, 1] at this training step, counted from 0."""
        if self.kind == "none" or step >= self.n_steps:
            return 1.0
        if self.kind == "linear":
            return step / self.n_steps
        into_cycle = step * N_CYCLES / self.n_steps % 1
        return min(1.0, into_cycle / RISING_SHARE)


def free_bits(divergence: Float[Tensor, "B J"], nats: float) -> Float[Tensor, " B"]:
    """Divergences summed over dimensions, of which each costs at least ``nats`` (Kingma et al. 2016, eq. 15).

    The mean over the batch is the sum of max(mean divergence of the dimension, nats). A dimension below the
    floor has no gradient: nothing pulls it to the prior, so it stays in use at no cost.
    """
    if not nats:
        return divergence.sum(-1)
    return divergence.where(mean_over_processes(divergence.mean(0)) > nats, nats).sum(-1)
