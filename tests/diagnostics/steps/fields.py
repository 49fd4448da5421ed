"""Policies whose samples are known: exact velocity fields of flow matching, integrated here from scratch."""

from dataclasses import dataclass

import numpy as np

from lerobot_act_chunking.diagnostics.core.measures import RawUnits
from lerobot_act_chunking.diagnostics.steps.grid import Cell, make_grid
from lerobot_act_chunking.diagnostics.steps.measuring import Demonstrated
from lerobot_act_chunking.sampling.process import Flow

T, A = 5, 2
MEASURE = RawUnits(("x", "y"))
EVALUATIONS = {"euler": 1, "midpoint": 2, "heun": 2, "rk4": 4}


OWN = Cell("euler", 10)


def grid_of(own=OWN, **options):
    return make_grid(Flow("velocity", "uniform"), own, **options)


@dataclass
class Mixture:
    """For each observation a mixture of Gaussians of one width: exact field, exact velocity.

    Args:
        means: (M, modes, T, A).
        masses: (modes,).
        width: standard deviation within a mode.
    """

    means: np.ndarray
    masses: np.ndarray
    width: float

    noise_shape = (T, A)

    def sample(self, cell, rows, noise):
        noise = noise.double().numpy()
        x = noise.copy()  # (N, b, T, A)
        means = self.means[rows]
        for i in range(cell.n_steps):
            x = _step(cell.sampler, lambda at, t: self.velocity(at, t, means), x, i, cell.n_steps)
        return x

    def velocity(self, x, t, means):
        """E[actions - noise | x] at time t: 0 noise, 1 actions."""
        variance = (t * self.width) ** 2 + (1 - t) ** 2
        offsets = x[:, :, None] - t * means  # (N, b, modes, T, A)
        logits = np.log(self.masses) - (offsets**2).sum((-2, -1)) / (2 * variance)
        weights = np.exp(logits - logits.max(-1, keepdims=True))
        weights /= weights.sum(-1, keepdims=True)
        by_mode = means + (t * self.width**2 - (1 - t)) / variance * offsets
        return (weights[..., None, None] * by_mode).sum(2)

    def milliseconds(self, cell):
        return cell.n_steps * EVALUATIONS[cell.sampler] * 2.0

    def demonstrated(self, seed=1, bias=0.0):
        """One draw from the mixture of every observation; the second half of each chunk is near contact."""
        rng = np.random.default_rng(seed)
        modes = rng.choice(len(self.masses), len(self.means), p=self.masses)
        chosen = self.means[np.arange(len(modes)), modes]
        near = np.zeros((len(modes), T), bool)
        near[::2, T // 2 :] = True
        return Demonstrated(chosen + bias + self.width * rng.standard_normal(chosen.shape), near)


def gaussian(width, count=256, seed=0):
    """One mode for each observation."""
    return Mixture(np.random.default_rng(seed).normal(size=(count, 1, T, A)), np.ones(1), width)


def three_modes(masses=(0.7, 0.2, 0.1), count=256, apart=4.0, width=0.05):
    """As many of three directions at 120 degrees as there are masses, the same for all steps of a chunk."""
    angles = np.radians([90, 210, 330])[: len(masses)]
    means = np.repeat(apart / np.sqrt(3) * np.stack([np.cos(angles), np.sin(angles)], -1)[:, None], T, 1)
    return Mixture(np.broadcast_to(means, (count, len(masses), T, A)), np.array(masses), width)


def _step(sampler, velocity, x, i, n):
    h, t = 1 / n, i / n
    first = velocity(x, t)
    if sampler == "euler":
        return x + h * first
    if sampler == "midpoint":
        return x + h * velocity(x + h / 2 * first, t + h / 2)
    if sampler == "heun":
        return x + h / 2 * (first + velocity(x + h * first, t + h))
    second = velocity(x + h / 2 * first, t + h / 2)
    third = velocity(x + h / 2 * second, t + h / 2)
    fourth = velocity(x + h * third, t + h)
    return x + h / 6 * (first + 2 * second + 2 * third + fourth)
