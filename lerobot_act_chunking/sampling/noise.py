"""Noise of several environments, each with its own, and noise that stays with the steps it was drawn for."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.sampling.episodes import Environments, Episodes


class NoiseSource:
    """Standard normal noise from one generator per environment, so that no environment depends on the others.

    Generators run on the CPU: the noise is the same on every device.

    Args:
        seed: together with an environment's episode it decides all of that episode's noise.
        episodes: which episode each environment is in; by default the first. Sources that share one are
            reset together, after its ``begin``.
        stream: sources with different numbers are independent of each other.
    """

    def __init__(self, seed: int, episodes: Episodes | None = None, stream: int = 0):
        self.seed = seed
        self.episodes = episodes or Episodes()
        self.stream = stream
        self._generators: dict[int, torch.Generator] = {}

    def reset(self, envs: Environments = None) -> None:
        """Go to the start of the stream of the episode that these environments are in."""
        for env in list(self._generators) if envs is None else envs:
            self._generators.pop(int(env), None)

    def generators(
        self, batch_size: int, envs: Environments = None, n_samples: int = 1
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
        self, batch_size: int, shape: Sequence[int], *, envs: Environments = None, n_samples: int = 1
    ) -> Float[Tensor, "n *S"]:
        """(n_samples * batch_size, ``*shape``) noise, sample-major, on the CPU.

        An environment's first sample is the one it would have drawn alone.
        """
        generators = self.generators(batch_size, envs, n_samples)
        return torch.stack([torch.randn(*shape, generator=generator) for generator in generators])

    def _generator(self, env: int) -> torch.Generator:
        if env not in self._generators:
            self._generators[env] = self.episodes.generator(self.seed, env, self.stream)
        return self._generators[env]


class NoiseHold:
    """Noise that stays with the keyframe it was drawn for, however often that is planned again.

    The sampler then sees the same noise for the same moment, and stays with the mode it has begun.

    Args:
        source: where new noise comes from; it is drawn keyframe by keyframe, so that it does not depend on
            the replanning rhythm.
    """

    def __init__(self, source: NoiseSource):
        self.source = source
        self._held: dict[int, tuple[int, Float[Tensor, "t A"]]] = {}  # first keyframe, noise from there on

    def reset(self, envs: Environments = None) -> None:
        """Forget these environments' noise; all: equal to a fresh one. The source is not reset."""
        for env in list(self._held) if envs is None else envs:
            self._held.pop(int(env), None)

    def draw(
        self, batch_size: int, shape: tuple[int, int], first: int, *, envs: Environments = None
    ) -> Float[Tensor, "n T A"]:
        """Noise for a chunk of each environment.

        Args:
            batch_size: number of environments, used where ``envs`` is None: they are then 0, 1, ...
            shape: keyframes and dimensions of a chunk.
            first: number of the chunk's first keyframe, counted from any moment on that stays the same.
            envs: indices of the environments.

        Raises:
            ValueError: keyframes before those of an earlier chunk.
        """
        rows = range(batch_size) if envs is None else [int(env) for env in envs]
        return torch.stack([self._chunk(env, shape, first) for env in rows])

    def _chunk(self, env: int, shape: tuple[int, int], first: int) -> Float[Tensor, "T A"]:
        horizon, action_dim = shape
        held_first, held = self._held.get(env, (first, torch.empty(0, action_dim)))
        if first < held_first:
            raise ValueError(
                f"keyframe {first} of environment {env} lies before its last chunk, which began at "
                f"{held_first}: reset first"
            )
        (generator,) = self.source.generators(1, [env])
        missing = range(held_first + len(held), first + horizon)
        new = [torch.randn(action_dim, generator=generator) for _ in missing]
        noise = torch.cat([held, torch.stack(new)]) if new else held
        noise = noise[first - held_first :]
        self._held[env] = (first, noise)
        return noise[:horizon]
