"""Random streams of acting: one for each (seed, environment, episode), so that no episode replays another."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Int64
from torch import Tensor

Environments = Int64[Tensor, " n"] | Sequence[int] | None  # indices; None: all of them

COUNTED, KNOWN = 0, 1  # the first word of a key: neither kind of episode can meet the other's stream


class Episodes:
    """Which episode each environment is in.

    Episodes are counted from 0 in every environment. One in which nothing was drawn is not counted, so that
    it does not matter how often a policy is reset before it acts. If the seeds of the episodes are known,
    they take the place of environment and count: the draws of an episode then depend neither on how many
    environments run together nor on the episodes before.
    """

    def __init__(self):
        self._counts: dict[int, int] = {}
        self._seeds: dict[int, int] = {}
        self._drawn: set[int] = set()

    def begin(self, envs: Environments = None, seeds: Sequence[int] | None = None) -> None:
        """The next episode begins in these environments.

        Args:
            envs: their indices; None for all.
            seeds: of their episodes, if known: one for each of ``envs``, or for the environments 0, 1, ...

        Raises:
            ValueError: not one seed for each environment, or a negative one.
        """
        chosen = None if envs is None else [int(env) for env in envs]
        if seeds is not None and chosen is not None and len(seeds) != len(chosen):
            raise ValueError(f"{len(seeds)} seeds for {len(chosen)} environments: give one for each")
        if seeds is not None and any(seed < 0 for seed in seeds):
            raise ValueError(f"seeds of episodes must not be negative: {list(seeds)}")
        for env in (self._drawn | self._seeds.keys()) if chosen is None else chosen:
            self._counts[env] = self._counts.get(env, 0) + (env in self._drawn)
            self._drawn.discard(env)
            self._seeds.pop(env, None)
        if seeds is not None:
            self._seeds.update(
                zip(range(len(seeds)) if chosen is None else chosen, map(int, seeds), strict=True)
            )

    def generator(self, seed: int, env: int, stream: int = 0) -> torch.Generator:
        """A new generator on the CPU, at the start of the stream of an environment's episode.

        Args:
            seed: of the policy's draws.
            env: index of the environment.
            stream: one of several that an episode needs, each independent of the others.
        """
        self._drawn.add(env)
        known = self._seeds.get(env)
        episode = (COUNTED, env, self._counts.get(env, 0)) if known is None else (KNOWN, known)
        mixed = np.random.SeedSequence(seed, spawn_key=(stream, *episode))
        return torch.Generator().manual_seed(int(mixed.generate_state(1, np.uint64)[0]))
