"""The random numbers of acting: which latent, and which of the likely actions."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from lerobot_act_chunking.sampling.episodes import Environments, Episodes
from lerobot_act_chunking.sampling.held_draws import HeldDraws
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
    """Draws of every environment for the latent, which may be held, and for the action head.

    Args:
        seed: together with an environment's episode it decides all of that episode's numbers.
        n_noise: numbers that make a latent; None if none is sampled.
        draws_shape: numbers by which the head samples a chunk; None if it does not sample.
        hold_steps: control steps for which a latent is held; see `HeldDraws`.
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
        episodes = episodes or Episodes()
        latents, choices = NoiseSource(seed, episodes, LATENTS), NoiseSource(seed, episodes, CHOICES)
        self._latents = (
            None
            if n_noise is None
            else HeldDraws(latents, (n_noise,), torch.randn, hold_steps=float(hold_steps))
        )
        self._choices = None if draws_shape is None else HeldDraws(choices, draws_shape, torch.rand)

    def reset(self, envs: Environments = None) -> None:
        """Drop what is held and go to the start of these environments' episodes."""
        for part in (self._latents, self._choices):
            if part is not None:
                part.reset(envs)

    def draw(self, batch_size: int, *, envs: Environments = None, n_samples: int = 1, step: int = 0) -> Draws:
        """Numbers for ``n_samples`` chunks of each environment, on the CPU; see `HeldDraws.draw`."""
        return Draws(
            *(
                None if part is None else part.draw(batch_size, envs=envs, n_samples=n_samples, step=step)
                for part in (self._latents, self._choices)
            )
        )
