"""The inner loops of sampling: from noise to actions in a few evaluations of a denoiser."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor

Denoise = Callable[[Float[Tensor, "B T A"], int], Float[Tensor, "B T A"]]
"""(x, i) -> x0: the clean actions as estimated from x in evaluation i, at time ``times[i]``; unclipped."""

Generators = Sequence[torch.Generator] | torch.Generator | Callable[[Tensor], Tensor] | None
"""One for each row of the batch, one for all, what gives noise like x, or none where nothing is drawn."""


@dataclass(frozen=True, eq=False)
class Sampler(ABC):
    """Turns noise into actions. Immutable: any number of threads may sample at once.

    Args:
        times: network times of all evaluations, in order.
        clip: bound of the estimates of the clean actions [normalised units]; None leaves them as they are.
    """

    times: Float[Tensor, " n_evaluations"]
    clip: float | None

    @abstractmethod
    def __call__(
        self, denoise: Denoise, x: Float[Tensor, "B T A"], generators: Generators = None
    ) -> Float[Tensor, "B T A"]:
        """The actions.

        Args:
            denoise: the network's estimates.
            x: noise, or actions noised to ``times[0]`` where the sampler starts later than from noise.
            generators: for samplers that draw (``ddpm``); their state moves on.

        Raises:
            ValueError: the sampler draws and has no generators.
        """

    def _clipped(self, clean: Float[Tensor, "B T A"]) -> Float[Tensor, "B T A"]:
        return clean if self.clip is None else clean.clamp(-self.clip, self.clip)


@dataclass(frozen=True)
class Step:
    """One linear step, x <- of_x * x + of_clean * clipped x0 + ...; the rest is what only some samplers have.

    Args:
        of_x: weight of x.
        of_clean: weight of the clipped estimate.
        of_unclipped: weight of the estimate as it came.
        of_previous: weight of the clipped estimate of the step before.
        noise: standard deviation of fresh noise.
    """

    of_x: float
    of_clean: float
    of_unclipped: float = 0.0
    of_previous: float = 0.0
    noise: float = 0.0


@dataclass(frozen=True, eq=False)
class LinearSampler(Sampler):
    """One evaluation a step, and every step a fixed linear combination: Euler, DDIM, DDPM, DPM-Solver++.

    Args:
        steps: as many as there are times.
    """

    steps: tuple[Step, ...]

    def __call__(
        self, denoise: Denoise, x: Float[Tensor, "B T A"], generators: Generators = None
    ) -> Float[Tensor, "B T A"]:
        """The actions; see `Sampler`."""
        previous = x
        for i, step in enumerate(self.steps):
            unclipped = denoise(x, i)
            clean = self._clipped(unclipped)
            x = torch.add(x * step.of_x, clean, alpha=step.of_clean)
            if step.of_unclipped:
                x = x.add_(unclipped, alpha=step.of_unclipped)
            if step.of_previous:
                x = x.add_(previous, alpha=step.of_previous)
            if step.noise:
                x = x.add_(draw_like(x, generators), alpha=step.noise)
            previous = clean
        return x


def deterministic_steps(
    levels: Sequence[tuple[float, float]], *, keep_direction: bool = False
) -> tuple[Step, ...]:
    """From level to level along the noise that x implies: DDIM (Song et al. 2021, eq. 12), Euler for a flow.

    With n = (x - alpha * x0) / sigma, the next x is alpha' * x0 + sigma' * n.

    Args:
        levels: (alpha, sigma) of every evaluation, and last of the result.
        keep_direction: let n follow from the unclipped x0, as diffusers and LeRobot have it by default. Their
            x then lies off the line through the clipped x0, and may end outside the clip range.
    """
    steps = []
    for (alpha, sigma), (next_alpha, next_sigma) in pairwise(levels):
        of_x = next_sigma / sigma
        of_direction = -of_x * alpha
        if keep_direction:
            steps.append(Step(of_x, next_alpha, of_unclipped=of_direction))
        else:
            steps.append(Step(of_x, next_alpha + of_direction))
    return tuple(steps)


def draw_like(x: Float[Tensor, "B *S"], generators: Generators) -> Float[Tensor, "B *S"]:
    """Standard normal noise; with one generator for each row, no row depends on the others.

    Raises:
        ValueError: no generators, or not one for each row.
    """
    if generators is None:
        raise ValueError("this sampler draws noise in every step: pass it a generator for each environment")
    if callable(generators):
        return generators(x)
    if isinstance(generators, torch.Generator):
        return torch.randn(x.shape, generator=generators, dtype=x.dtype, device=generators.device).to(
            x.device
        )
    rows = [
        torch.randn(row.shape, generator=generator, dtype=x.dtype, device=generator.device)
        for row, generator in zip(x, generators, strict=True)
    ]
    return torch.stack(rows).to(x.device)
