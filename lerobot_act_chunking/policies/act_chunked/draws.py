"""The random numbers of acting: which latent, and which of the likely actions."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from lerobot_act_chunking.sampling.episodes import Environments, Episodes
from lerobot_act_chunking.sampling.noise import NoiseSource

LATENTS, CHOICES = 0, 1  # independent streams: neither changes the other


class Draws(NamedTuple):
    """Numbers for N chunks of each of n environments; None where acting takes what is likeliest.

    Attributes:
        latent: (N, n, L) standard normal, from which the latent is made.
        actions: (N, n, ...) uniform in [0, 1), by which the action head samples.
    """

    latent: Tensor | None
    actions: Tensor | None

    def flat(self) -> "Draws":
        """The same numbers with one axis (N * n) for all chunks."""
        return Draws(*(None if each is None else each.flatten(0, 1) for each in self))


class ActingDraws:
    """Draws of every environment, from generators of its own, so that none depends on the others.

    An environment's first chunk of several is the one that it would have drawn alone.
    A latent may be held: chunks that follow each other then carry on with the same way of acting.

    Args:
        seed: together with an environment's episode it decides all of that episode's numbers.
        n_noise: numbers that make a latent; None if none is sampled.
        draws_shape: numbers by which the head samples a chunk; None if it does not sample.
        hold_steps: control steps for which a latent is held: 0 for a new one with every chunk,
            ``math.inf`` to the end of the episode.
        episodes: which episode each environment is in; by default the first.
    """

    def __init__(
        self,
        seed: int,
        *,
        n_noise: int | None,
        draws_shape: Sequence[int] | None,
        hold_steps: float,
        episodes: Episodes | None = None,
    ):
        self.n_noise, self.draws_shape, self.hold_steps = n_noise, draws_shape, hold_steps
        episodes = episodes or Episodes()
        self._latents = NoiseSource(seed, episodes, LATENTS)
        self._choices = NoiseSource(seed, episodes, CHOICES)
        self._held: dict[int, tuple[Tensor, float]] = {}  # latent noise (N, L), step up to which it is held

    def reset(self, envs: Environments = None) -> None:
        """Forget what is held and go to the start of these environments' episodes."""
        self._latents.reset(envs)
        self._choices.reset(envs)
        for env in list(self._held) if envs is None else envs:
            self._held.pop(int(env), None)

    def draw(self, batch_size: int, *, envs: Environments = None, n_samples: int = 1, step: int = 0) -> Draws:
        """Numbers for ``n_samples`` chunks of each environment, on the CPU.

        Args:
            batch_size: number of environments, used where ``envs`` is None: they are then 0, 1, ...
            envs: their indices.
            n_samples: N, chunks of each.
            step: control steps that have passed; a latent is held for some of them.
        """
        rows = range(batch_size) if envs is None else [int(env) for env in envs]
        latent = [self._latent(env, n_samples, step) for env in rows] if self.n_noise is not None else None
        actions = [self._actions(env, n_samples) for env in rows] if self.draws_shape is not None else None
        return Draws(*(None if each is None else torch.stack(each, dim=1) for each in (latent, actions)))

    def _latent(self, env: int, n_samples: int, step: int) -> Tensor:
        noise, until = self._held.get(env, (None, -math.inf))
        if noise is None or len(noise) != n_samples or step >= until:
            (generator,) = self._latents.generators(1, [env])
            size = self.n_noise or 0
            noise = torch.stack([torch.randn(size, generator=generator) for _ in range(n_samples)])
            self._held[env] = (noise, step + self.hold_steps)
        return noise

    def _actions(self, env: int, n_samples: int) -> Tensor:
        (generator,) = self._choices.generators(1, [env])
        shape = self.draws_shape or ()
        return torch.stack([torch.rand(*shape, generator=generator) for _ in range(n_samples)])
