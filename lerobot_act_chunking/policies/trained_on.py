"""What a checkpoint remembers of the demonstrations, so that a robot can be compared with them."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.utils.constants import ACTION

from lerobot_act_chunking.data.dimension_names import given_names

PARKED = 0.05  # of a vector's widest range: what moves less was parked, and its noise says nothing


@dataclass
class TrainedOn:
    """The demonstrations of a training, as far as a robot has to be like them.

    Attributes:
        fps: control steps per second.
        names: of the dimensions of each vector, by LeRobot's key; none where the dataset has none.
        low: least value of each dimension in the demonstrations, by key, in the robot's units.
        high: greatest value, likewise.
        largest_change: of each action dimension in one control step, as in 19 of 20 episodes.
    """

    fps: float | None = None
    names: dict[str, list[str]] = field(default_factory=dict)
    low: dict[str, list[float]] = field(default_factory=dict)
    high: dict[str, list[float]] = field(default_factory=dict)
    largest_change: list[float] = field(default_factory=list)

    @classmethod
    def of_dataset(cls, meta: Any, keys: list[str]) -> "TrainedOn":
        """What a dataset says of these vectors, by LeRobot's metadata of it and its actions."""
        from lerobot_act_chunking.data.actions import largest_changes

        found = cls(fps=float(meta.fps))
        for key in (each for each in keys if each in meta.features):
            if names := given_names(meta.features[key]):
                found.names[key] = list(names)
            stats = (meta.stats or {}).get(key, {})
            if {"min", "max"} <= stats.keys():
                found.low[key], found.high[key] = (np.ravel(stats[name]).tolist() for name in ("min", "max"))
        if len(shape := meta.features.get(ACTION, {}).get("shape", ())) == 1:
            found.largest_change = largest_changes(Path(meta.root), shape[0]).tolist()
        return found

    def spans(self, key: str) -> np.ndarray:
        """The demonstrated range of each dimension; of a parked one what counts as moving."""
        span = np.array(self.high[key]) - np.array(self.low[key])
        return np.maximum(span, max(PARKED * span.max(), 1e-6))


@dataclass
class RemembersTraining:
    """Mixin for policy configurations that hold what the policy was trained on.

    Attributes:
        trained_on: not a setting: rate, names, ranges and speeds of the demonstrations. Training fills it in.
    """

    trained_on: TrainedOn | None = None

    @property
    def action_feature_names(self) -> list[str] | None:
        """The action's names, where ``lerobot-rollout`` looks for them to compare them with the robot's."""
        return None if self.trained_on is None else self.trained_on.names.get(ACTION)

    @action_feature_names.setter
    def action_feature_names(self, names: list[str]) -> None:
        """LeRobot sets those of the dataset, which `remember` reads, too, also where they are in groups."""

    def remember(self, meta: Any) -> None:
        """Hold what a dataset is like that the policy is trained on, in place of the one before.

        Args:
            meta: LeRobot's metadata of it.
        """
        inputs: dict[str, Any] = getattr(self, "input_features", None) or {}
        vectors = [key for key, each in inputs.items() if len(each.shape) == 1]
        self.trained_on = TrainedOn.of_dataset(meta, [*vectors, ACTION])


def wrong_rate(config: Any, fps: float) -> str | None:
    """The sentence that says so, if a policy is to act at another rate than that of its demonstrations.

    Args:
        config: the policy's.
        fps: control steps per second.
    """
    trained_on = getattr(config, "trained_on", None)
    known = None if trained_on is None else trained_on.fps
    if not known or abs(known - fps) <= 0.01 * known:
        return None
    factor, pace = (known / fps, "slowly") if fps < known else (fps / known, "fast")
    return (
        f"the policy was trained at {known:g} control steps a second and acts at {fps:g}: {factor:.3g} times "
        f"as {pace} as demonstrated; set --fps={known:g}"
    )
