"""The sampler of two regressions, one upon the other."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.sampling.solvers import Denoise, Generators, Sampler


@dataclass(frozen=True, eq=False)
class TwoStepSampler(Sampler):
    """Predicts from nothing, then again from that prediction, shrunk to ``times[1]`` (Pan et al. 2025).

    The noise that the second pass saw in training is left out: the result is deterministic, and the noise
    given is only looked at for its shape.
    """

    def __call__(
        self, denoise: Denoise, x: Float[Tensor, "B T A"], generators: Generators = None
    ) -> Float[Tensor, "B T A"]:
        """The actions; see `Sampler`."""
        draft = self._clipped(denoise(torch.zeros_like(x), 0))
        return self._clipped(denoise(draft * self.times[1], 1))
