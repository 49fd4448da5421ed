"""Noise of several environments, each with its own, and noise that stays with the steps it was drawn for."""

from collections.abc import Iterable, Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor


class NoiseSource:
    """Standard normal noise from one generator per environment, so that no environment depends on the others.

    Generators run on the CPU: the noise is the same on every device.

    Args:
        seed: together with an environment's index it decides all of that environment's noise.
    """

    def __init__(self, seed: int):
        self.seed = seed
        self._generators: dict[int, torch.Generator] = {}

    def reset(self, envs: Iterable[int] | None = None) -> None:
        """Begin these environments' noise anew; all: equal to a fresh source."""
        for env in list(self._generators) if envs is None else envs:
            self._generators.pop(int(env), None)

    def generators(
        self, batch_size: int, envs: Iterable[int] | None = None, n_samples: int = 1
    ) -> list[torch.Generator]:
        """The generator of each row of a batch of ``n_samples`` times these environments, sample-major.

        Args:
            batch_size: number of environments, used where ``envs`` is None: they are then 0, 1, ...
            envs: their indices.
            n_samples: how many rows each environment has.
        """
        rows = range(batch_size) if envs is None else envs
        return [self._generator(int(env)) for env in rows] * n_samples

    def draw(
        self, batch_size: int, shape: Sequence[int], *, envs: Iterable[int] | None = None, n_samples: int = 1
    ) -> Float[Tensor, "n *S"]:
        """(n_samples * batch_size, ``*shape``) noise, sample-major, on the CPU.

        An environment's first sample is the one it would have drawn alone.
        """
        generators = self.generators(batch_size, envs, n_samples)
        return torch.stack([torch.randn(*shape, generator=generator) for generator in generators])

    def _generator(self, env: int) -> torch.Generator:
        if env not in self._generators:
            mixed = np.random.SeedSequence((self.seed, env)).generate_state(1, np.uint64)
            self._generators[env] = torch.Generator().manual_seed(int(mixed[0]))
        return self._generators[env]
