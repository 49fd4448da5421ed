"""The random numbers that pick codes."""

import torch
from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.sampling.episodes import Environments, Episodes
from lerobot_act_chunking.sampling.noise import NoiseSource


class CodeDraws:
    """One uniform number for each code of a chunk, from one generator per environment.

    Args:
        seed: together with an environment's episode it decides all of that episode's numbers.
        n_codes: G, codes of a chunk.
        held: draw once an episode. The same numbers then pick the codes of all of its chunks: as long as the
            policy sees the same choice, it chooses alike.
        episodes: which episode each environment is in; by default the first.
    """

    def __init__(self, seed: int, n_codes: int, *, held: bool, episodes: Episodes | None = None):
        self.n_codes = n_codes
        self.held = held
        self._source = NoiseSource(seed, episodes)
        self._kept: dict[int, Float[Tensor, "N G"]] = {}

    def reset(self, envs: Environments = None) -> None:
        """Forget what is held and go to the start of these environments' episodes."""
        self._source.reset(envs)
        for env in list(self._kept) if envs is None else envs:
            self._kept.pop(int(env), None)

    def draw(
        self, batch_size: int, *, envs: Environments = None, n_samples: int = 1
    ) -> Float[Tensor, "N n G"]:
        """Numbers in [0, 1) for ``n_samples`` chunks of each environment (None: 0, 1, ...), on the CPU."""
        rows = range(batch_size) if envs is None else [int(env) for env in envs]
        return torch.stack([self._of(env, n_samples) for env in rows], dim=1)

    def _of(self, env: int, n_samples: int) -> Float[Tensor, "N G"]:
        kept = self._kept.get(env)
        if kept is not None and len(kept) == n_samples:
            return kept
        (generator,) = self._source.generators(1, [env])
        drawn = torch.rand(n_samples, self.n_codes, generator=generator)
        if self.held:
            self._kept[env] = drawn
        return drawn
