"""Samplers of rectified flows: solvers of dx/dt = (x0 - x) / (1 - t) from noise, t = 0, to actions, t = 1."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.sampling.solvers import (
    Denoise,
    Generators,
    LinearSampler,
    Sampler,
    deterministic_steps,
)


@dataclass(frozen=True)
class Tableau:
    """An explicit Runge-Kutta method.

    Args:
        nodes: where in the step the stages are [0..1].
        rows: of each stage, the weights of the slopes before it.
        weights: of the slopes in the step.
    """

    nodes: tuple[float, ...]
    rows: tuple[tuple[float, ...], ...]
    weights: tuple[float, ...]


EULER = Tableau((0.0,), ((),), (1.0,))
MIDPOINT = Tableau((0.0, 1 / 2), ((), (1 / 2,)), (0.0, 1.0))
HEUN = Tableau((0.0, 1.0), ((), (1.0,)), (1 / 2, 1 / 2))
HEUN_THIRD_ORDER = Tableau((0.0, 1 / 3, 2 / 3), ((), (1 / 3,), (0.0, 2 / 3)), (1 / 4, 0.0, 3 / 4))
RK4 = Tableau(
    (0.0, 1 / 2, 1 / 2, 1.0), ((), (1 / 2,), (0.0, 1 / 2), (0.0, 0.0, 1.0)), (1 / 6, 1 / 3, 1 / 3, 1 / 6)
)

# All steps but the last, the last. At t = 1 a clean estimate no longer tells the slope (0 / 0): no stage of
# the last step may lie there. One step of order p - 1 leaves an error of h^p: the whole keeps its order p.
METHODS = {"midpoint": (MIDPOINT, MIDPOINT), "heun": (HEUN, EULER), "rk4": (RK4, HEUN_THIRD_ORDER)}


@dataclass(frozen=True, eq=False)
class RungeKuttaSampler(Sampler):
    """Several evaluations a step.

    Args:
        grid: times between the steps, from the first step's start to 1.
        tableaus: the method of each step.
    """

    grid: tuple[float, ...]
    tableaus: tuple[Tableau, ...]

    def __call__(
        self, denoise: Denoise, x: Float[Tensor, "B T A"], generators: Generators = None
    ) -> Float[Tensor, "B T A"]:
        """The actions; see `Sampler`."""
        evaluation = 0
        for start, end, tableau in zip(self.grid, self.grid[1:], self.tableaus, strict=False):
            step = end - start
            slopes: list[Tensor] = []
            for node, row in zip(tableau.nodes, tableau.rows, strict=True):
                stage = _advance(x, slopes, row, step)
                clean = self._clipped(denoise(stage, evaluation))
                slopes.append((clean - stage) / (1 - start - node * step))
                evaluation += 1
            x = _advance(x, slopes, tableau.weights, step)
        return x


def _advance(x: Tensor, slopes: list[Tensor], weights: tuple[float, ...], step: float) -> Tensor:
    for slope, weight in zip(slopes, weights, strict=True):
        if weight:
            x = torch.add(x, slope, alpha=weight * step)
    return x


def make_flow_sampler(
    name: str, num_inference_steps: int, *, strength: float, clip: float | None
) -> LinearSampler | RungeKuttaSampler:
    """``euler``, ``midpoint``, ``heun`` or ``rk4``; see `make_sampler`. The arguments are checked."""
    start = min(round((1 - strength) * num_inference_steps), num_inference_steps - 1)
    grid = tuple(k / num_inference_steps for k in range(start, num_inference_steps + 1))
    if name == "euler":
        return LinearSampler(torch.tensor(grid[:-1]), clip, deterministic_steps([(t, 1 - t) for t in grid]))
    tableau, last = METHODS[name]
    tableaus = (tableau,) * (len(grid) - 2) + (last,)
    times = [
        t + node * (end - t)
        for t, end, tableau in zip(grid, grid[1:], tableaus, strict=False)
        for node in tableau.nodes
    ]
    return RungeKuttaSampler(torch.tensor(times), clip, grid, tableaus)
