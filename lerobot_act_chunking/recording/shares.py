"""How often a recording shows each of the equally valid ways of doing a task."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from lerobot_act_chunking.errors import ConfigurationError

_GOLDEN = (math.sqrt(5) - 1) / 2


@dataclass(frozen=True)
class ModeShares:
    """Percentages of the episodes that go each way; a task that can be done one way only has 100 of it.

    Attributes:
        percentages: one for each way, 100 together.
    """

    percentages: tuple[float, ...] = (100.0,)

    @classmethod
    def of_task(cls, modes: int, asked: Sequence[float]) -> Self:
        """The shares asked for of a task with so many modes, or equal ones where none are.

        Raises:
            ConfigurationError: not one share for each way, a negative one, or not 100 % together.
        """
        if not asked:
            return cls((100 / modes,) * modes)
        shown = f"mode_shares {','.join(f'{share:g}' for share in asked)}"
        if modes == 1:
            raise ConfigurationError(f"{shown}: the task is done one way only; leave the shares out")
        example = f"give {modes} percentages that sum to 100, as in 80,15,5"
        if len(asked) != modes:
            raise ConfigurationError(f"{shown}: {len(asked)} shares of a task with {modes} modes; {example}")
        if not all(share >= 0 for share in asked):
            raise ConfigurationError(f"{shown}: no share is negative; {example}")
        if not math.isclose(sum(asked), 100, abs_tol=1e-6):
            raise ConfigurationError(f"{shown}: the shares sum to {sum(asked):g}; {example}")
        return cls(tuple(map(float, asked)))

    def mode_of(self, seed: int) -> int:
        """Which way the episode of ``seed`` goes.

        Multiples of the golden ratio fill 0 .. 1 evenly and never in step with people who take turns: any run
        of seeds has nearly these shares, for each person too.
        """
        return int(np.searchsorted(np.cumsum(self.percentages[:-1]), 100 * (seed * _GOLDEN % 1), "right"))

    def counts(self, episodes: int) -> list[int]:
        """How many of so many episodes go each way: the nearest whole numbers (largest remainders)."""
        exact = np.array(self.percentages) * episodes / 100
        counts = np.floor(exact + 1e-9).astype(int)
        most_left = np.argsort(np.round(counts - exact, 9), kind="stable")
        counts[most_left[: episodes - counts.sum()]] += 1
        return counts.tolist()


ONE_WAY = ModeShares()
