"""What is written down of a group of episodes that acted together."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from lerobot_act_chunking.diagnostics.core.played import Episode
from lerobot_act_chunking.diagnostics.core.rollouts import Rollout


@dataclass(frozen=True)
class Timing:
    """How long acting took, for all episodes of a group together.

    Attributes:
        network_ms: of the control steps in which the network ran, median [ms]; None if it never ran.
        other_ms: of the others, median [ms]; None if there are none.
        seconds: for the whole group, simulation included.
    """

    network_ms: float | None
    other_ms: float | None
    seconds: float


@dataclass(frozen=True)
class Group:
    """Episodes that acted together.

    Attributes:
        episodes: in the order of their seeds.
        timing: how long they took; the only part that differs when they are run again.
    """

    episodes: tuple[Episode, ...]
    timing: Timing

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries."""
        return asdict(self)

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> "Group":
        """The group of `to_json`."""
        episodes = tuple(Episode(**each) for each in content["episodes"])
        return cls(episodes, Timing(**content["timing"]))


def timing_of(rollouts: Sequence[Rollout], seconds: float) -> Timing:
    """How long a group took.

    Args:
        rollouts: of the group, at least one.
        seconds: for all of it.
    """
    longest = max(rollouts, key=lambda each: len(each.commands))
    ran = np.zeros(len(longest.commands), bool)
    for rollout in rollouts:
        ran[[inference.step for inference in rollout.inferences]] = True
    network, other = (1000 * longest.acting_s[steps] for steps in (ran, ~ran))
    return Timing(_median(network), _median(other), seconds)


def _median(values: np.ndarray) -> float | None:
    return float(np.median(values)) if len(values) else None
