"""Effects of the start and of the architecture, and how sure they are."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from lerobot_act_chunking.diagnostics.lm_ablation.records import Record

REPETITIONS, LEVEL = 2000, 0.95
PRETRAINING = {"T-LM'": 0.5, "T-R": -0.5, "M-LM'": 0.5, "M-R": -0.5}
ARCHITECTURE = {"T-LM'": 0.5, "T-R": 0.5, "M-LM'": -0.5, "M-R": -0.5}
INTERACTION = {"T-LM'": 1.0, "T-R": -1.0, "M-LM'": -1.0, "M-R": 1.0}
FACTORIAL_EFFECTS = {
    "pretraining": PRETRAINING,
    "architecture": ARCHITECTURE,
    "interaction": INTERACTION,
}
"""Weights of the cells' success rates: of a pretrained start over a random one, of the transformer over the
mixer, and of how much more the transformer gains."""


@dataclass(frozen=True)
class Effect:
    """A weighted sum of cells' success rates.

    Attributes:
        name: of it.
        condition: under which the policies acted.
        size: demonstrations; None for the mean of all sizes.
        value: in [-1, 1] for a difference.
        interval: of 95 %, over training seeds and episodes.
        p_value: of there being none, two-sided: how often a repetition is on the other side of zero.
        seeds: how many trainings of each cell and size.
    """

    name: str
    condition: str
    size: int | None
    value: float
    interval: tuple[float, float]
    p_value: float
    seeds: int

    @property
    def decided(self) -> bool:
        """Whether the interval leaves out zero."""
        return self.interval[0] > 0 or self.interval[1] < 0


def effect(
    name: str,
    weights: Mapping[str, float],
    records: Sequence[Record],
    condition: str,
    sizes: Sequence[int],
    rng: np.random.Generator,
) -> Effect | None:
    """An effect with its interval; None if a cell lacks trainings.

    The same training seed stands for the same demonstrations and the same order of batches in all cells, an
    episode's seed for the same start: both are drawn for all cells together, seeds first, then episodes.

    Args:
        name: of the effect.
        weights: of the cells.
        records: finished trainings.
        condition: of the episodes.
        sizes: demonstrations, over which the mean is taken.
        rng: draws the repetitions.
    """
    found = {(each.cell, each.size, each.seed): each for each in records}
    seeds = sorted(
        seed
        for seed in {each.seed for each in records}
        if all((cell, size, seed) in found for cell in weights for size in sizes)
    )
    if not seeds:
        return None
    successes = np.array(
        [
            [[found[cell, size, seed].successes[condition] for seed in seeds] for size in sizes]
            for cell in weights
        ],
        float,
    )
    rates: Float[np.ndarray, "S E"] = np.tensordot(list(weights.values()), successes.mean(1), 1)
    n_seeds, n_episodes = rates.shape
    of_seeds, of_episodes = (
        rng.multinomial(n, [1 / n] * n, size=REPETITIONS) / n for n in (n_seeds, n_episodes)
    )
    drawn = np.sum(of_seeds @ rates * of_episodes, axis=1)
    low, high = np.quantile(drawn, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    beyond = min(np.sum(drawn <= 0), np.sum(drawn >= 0))
    p_value = min(1.0, 2 * float(1 + beyond) / (1 + REPETITIONS))
    size = sizes[0] if len(sizes) == 1 else None
    return Effect(name, condition, size, float(rates.mean()), (float(low), float(high)), p_value, n_seeds)
