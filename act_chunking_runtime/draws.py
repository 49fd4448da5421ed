"""The random numbers of acting, drawn by NumPy."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class DrawSpec:
    """Random numbers that a graph takes as an input.

    Attributes:
        name: of the input.
        shape: of the numbers.
        distribution: ``normal`` (standard) or ``uniform`` (in [0, 1)).
        hold_steps: control steps for which numbers are kept; 0 for new ones with every chunk, None to the end
            of the episode.
        moment_steps: control steps between two rows of the last axis but one, if each row stays with the
            moment that it was drawn for, however often that is planned again.
    """

    name: str
    shape: tuple[int, ...]
    distribution: Literal["normal", "uniform"]
    hold_steps: float | None = 0
    moment_steps: int | None = None


class Draws:
    """Numbers for one chunk after the other.

    Args:
        specs: what is drawn.
        generator: draws it.
    """

    def __init__(self, specs: list[DrawSpec], generator: np.random.Generator):
        self.specs = specs
        self.generator = generator
        self.reset()

    def reset(self) -> None:
        """An episode begins: nothing is kept. The generator goes on."""
        self._kept: dict[str, tuple[np.ndarray, float]] = {}  # numbers, and a step

    def take(self, step: int) -> dict[str, np.ndarray]:
        """The numbers of a chunk by name, single precision.

        Args:
            step: control steps of the episode that have passed.
        """
        return {
            spec.name: self._held(spec, step) if spec.moment_steps is None else self._of_moments(spec, step)
            for spec in self.specs
        }

    def _held(self, spec: DrawSpec, step: int) -> np.ndarray:
        numbers, until = self._kept.get(spec.name, (None, -math.inf))
        if numbers is None or step >= until:
            numbers = self._new(spec, spec.shape)
            hold = math.inf if spec.hold_steps is None else spec.hold_steps
            self._kept[spec.name] = numbers, step + hold
        return numbers

    def _of_moments(self, spec: DrawSpec, step: int) -> np.ndarray:
        first = step // (spec.moment_steps or 1)
        numbers, kept_from = self._kept.get(spec.name, (self._new(spec, spec.shape), first))
        n_over = min(first - int(kept_from), spec.shape[-2])
        new = self._new(spec, (*spec.shape[:-2], n_over, spec.shape[-1]))
        numbers = np.concatenate([numbers[..., n_over:, :], new], axis=-2)
        self._kept[spec.name] = numbers, first
        return numbers

    def _new(self, spec: DrawSpec, shape: tuple[int, ...]) -> np.ndarray:
        if spec.distribution == "normal":
            return self.generator.standard_normal(shape, dtype=np.float32)
        return self.generator.random(shape, dtype=np.float32)
