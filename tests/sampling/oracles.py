"""Perfect denoisers: the mean of the clean actions given x, in closed form."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_act_chunking.sampling.process import Process
from lerobot_act_chunking.sampling.samplers import Denoise, Sampler


@dataclass
class Gaussian:
    """Independent actions of N(mean, std^2)."""

    mean: float
    std: float

    def denoise(self, process: Process, sampler: Sampler) -> Denoise:
        alphas, sigmas = process.levels(sampler.times.double())

        def clean(x: Tensor, i: int) -> Tensor:
            variance = alphas[i] ** 2 * self.std**2 + sigmas[i] ** 2
            return self.mean + alphas[i] * self.std**2 / variance * (x - alphas[i] * self.mean)

        return clean

    def solution(self, process: Process, sampler: Sampler, x: Tensor, end: float | None = None) -> Tensor:
        """Where the exact ordinary differential equation leads from x at the sampler's first time.

        On its way a sample keeps its distance from the mean in standard deviations. End: at the clean time.
        """
        times = torch.stack([sampler.times[0], torch.tensor(process.clean_time if end is None else end)])
        (alpha, end_alpha), (sigma, end_sigma) = process.levels(times.double())
        std, end_std = (
            (a**2 * self.std**2 + s**2).sqrt() for a, s in ((alpha, sigma), (end_alpha, end_sigma))
        )
        return end_alpha * self.mean + end_std * (x - alpha * self.mean) / std


@dataclass
class Mixture:
    """Actions of several narrow modes."""

    means: Sequence[float]
    masses: Sequence[float]
    std: float

    def denoise(self, process: Process, sampler: Sampler) -> Denoise:
        alphas, sigmas = process.levels(sampler.times.double())
        means, log_masses = torch.tensor(self.means), torch.tensor(self.masses).log()

        def clean(x: Tensor, i: int) -> Tensor:
            variance = alphas[i] ** 2 * self.std**2 + sigmas[i] ** 2
            off = x[..., None] - alphas[i] * means
            shares = (log_masses - off**2 / (2 * variance)).softmax(-1)
            return (shares * (means + alphas[i] * self.std**2 / variance * off)).sum(-1)

        return clean

    def masses_of(self, actions: Tensor) -> Tensor:
        """The share of each mode in these actions, each counted for the nearest."""
        nearest = (actions.flatten()[:, None] - torch.tensor(self.means)).abs().argmin(1)
        return nearest.bincount(minlength=len(self.means)) / len(nearest)
