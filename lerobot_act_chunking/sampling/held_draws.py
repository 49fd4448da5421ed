"""Random numbers for each environment that stay the same for some control steps."""

import math
from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.sampling.episodes import Environments
from lerobot_act_chunking.sampling.noise import NoiseSource


class HeldDraws:
    """Numbers for N chunks of each environment, from one generator per environment.

    While numbers are held, chunks that follow each other are made from the same ones: the policy carries on
    with the choice it has made. An environment's first chunk of several is the one it would have drawn alone.

    Args:
        source: the environments' generators.
        shape: shape S of the numbers of one chunk.
        sample: draws them: `torch.randn` (standard normal) or `torch.rand` (uniform in [0, 1)).
        hold_steps: control steps for which they are held: 0 for new ones with every chunk, ``math.inf`` to
            the end of the episode.
    """

    def __init__(
        self,
        source: NoiseSource,
        shape: Sequence[int],
        sample: Callable[..., Tensor] = torch.randn,
        *,
        hold_steps: float = 0.0,
    ):
        self.shape = tuple(shape)
        self.hold_steps = hold_steps
        self.source = source
        self._sample = sample
        self._held: dict[int, tuple[Tensor, float]] = {}  # numbers (N, *S), step up to which they hold

    def reset(self, envs: Environments = None) -> None:
        """Drop what is held and go to the start of these environments' episodes."""
        self.source.reset(envs)
        for env in list(self._held) if envs is None else envs:
            self._held.pop(int(env), None)

    def draw(
        self, batch_size: int, *, envs: Environments = None, n_samples: int = 1, step: int = 0
    ) -> Float[Tensor, "N n *S"]:
        """Numbers for ``n_samples`` chunks of each environment, on the CPU.

        Args:
            batch_size: number of environments, used where ``envs`` is None: they are then 0, 1, ...
            envs: their indices.
            n_samples: N, chunks of each.
            step: control steps that have passed.
        """
        rows = range(batch_size) if envs is None else [int(env) for env in envs]
        return torch.stack([self._numbers(env, n_samples, step) for env in rows], dim=1)

    def _numbers(self, env: int, n_samples: int, step: int) -> Float[Tensor, "N *S"]:
        numbers, until = self._held.get(env, (None, -math.inf))
        if numbers is None or len(numbers) != n_samples or step >= until:
            (generator,) = self.source.generators(1, [env])
            numbers = torch.stack([self._sample(*self.shape, generator=generator) for _ in range(n_samples)])
            self._held[env] = (numbers, step + self.hold_steps)
        return numbers
