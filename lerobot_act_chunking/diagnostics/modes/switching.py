"""Whether episodes change their way while they run: chunk by chunk."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_act_chunking.diagnostics.core.rollouts import Rollout
from lerobot_act_chunking.diagnostics.modes.demonstrated import Demonstrated

EARLY = 0.5  # of a demonstration: later an episode's way is decided by where it is


@dataclass(frozen=True)
class Switching:
    """Episodes whose chunks were looked at.

    Attributes:
        episodes: with two chunks or more that go a demonstrated way, in the first half of the motion.
        switched: of these, those whose chunks go different ways.
    """

    episodes: int
    switched: int

    @property
    def share(self) -> float:
        """Of the episodes that change their way; 0 where none can be looked at."""
        return self.switched / self.episodes if self.episodes else 0.0


def find_switching(rollouts: Sequence[Rollout], demonstrated: Demonstrated) -> Switching:
    """Follow the way of each predicted chunk through the first half of every episode."""
    ways: list[set[int]] = [set() for _ in rollouts]
    counts = [0] * len(rollouts)
    last = EARLY * demonstrated.length
    calls: dict[int, list[tuple[int, np.ndarray]]] = {}
    for place, rollout in enumerate(rollouts):
        for each in rollout.inferences:
            if each.step <= last:
                calls.setdefault(each.step, []).append((place, each.chunk))
    for step, made in calls.items():
        chunks = demonstrated.scaled(np.stack([chunk for _, chunk in made]))
        reference = demonstrated.reference(step, chunks.shape[1])
        if not reference.tells_apart:
            continue
        for (place, _), mode in zip(made, reference.classify(chunks).tolist(), strict=True):
            if mode >= 0:
                ways[place].add(mode)
                counts[place] += 1
    several = [found for found, count in zip(ways, counts, strict=True) if count > 1]
    return Switching(len(several), sum(len(found) > 1 for found in several))
