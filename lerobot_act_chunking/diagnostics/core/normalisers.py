"""The statistics in a checkpoint's processors, against those of the data and against what is observed."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lerobot_act_chunking.policies.loading import LoadedPolicy
from lerobot_act_chunking.policies.statistics import needed_statistics

SHIFT = 0.5
"""Difference of two means, in standard deviations, from which they are of different data."""
SPREAD = 2.0
"""Ratio of two spreads from which they are of different data."""
FAR = 10.0
"""Standard deviations from the mean at which nothing in the training data lay."""
WIDEST = 1e-2
"""Share of a dimension's size below which its spread is rounding or noise, and does not count."""


@dataclass(frozen=True)
class Spread:
    """How the numbers of a feature are normalised.

    Attributes:
        centre: what becomes 0, (D,).
        half: what becomes 1, (D,).
    """

    centre: np.ndarray
    half: np.ndarray

    @property
    def is_inert(self) -> bool:
        """Whether it leaves numbers as they are."""
        return bool((self.centre == 0).all() and (self.half == 1).all())


def spreads_of(stats: Mapping[str, Mapping[str, Any]], config: Any) -> dict[str, Spread | None]:
    """Of every feature that the policy normalises; None where its statistics are missing.

    Args:
        stats: by key and name.
        config: of the policy that predicts.
    """
    found: dict[str, Spread | None] = {}
    for key, names in needed_statistics(config).items():
        given = stats.get(key, {})
        if not all(name in given for name in names):
            found[key] = None
            continue
        first, second = (np.ravel(np.asarray(given[name], dtype=np.float64)) for name in names)
        centred = names == ("mean", "std")
        found[key] = Spread(first, second) if centred else Spread((first + second) / 2, (second - first) / 2)
    return found


def processor_statistics(policy: LoadedPolicy) -> dict[str, dict[str, np.ndarray]]:
    """The statistics that a policy's processors use, by key and name; both hold more than that."""
    found: dict[str, dict[str, np.ndarray]] = {}
    for pipeline in (policy.preprocessor, policy.postprocessor):
        for step in getattr(pipeline, "steps", ()):
            if hasattr(step, "norm_map"):
                for name, value in step.state_dict().items():
                    key, _, statistic = name.rpartition(".")
                    if key in step.features:
                        found.setdefault(key, {})[statistic] = value.cpu().numpy()
    return found


def differing(
    ours: Mapping[str, Spread | None], theirs: Mapping[str, Spread | None], floor: float
) -> list[str]:
    """Keys whose two statistics are of different data.

    Args:
        ours: of the processors.
        theirs: of the dataset.
        floor: least spread that the processors divide by [raw units].
    """
    found = []
    for key, own in ours.items():
        other = theirs.get(key)
        if own is None or other is None or own.half.shape != other.half.shape:
            continue
        least = np.maximum(floor, WIDEST * np.abs(other.centre)) + 1e-6
        half, there = np.maximum(own.half, least), np.maximum(other.half, least)
        shifted = np.abs(own.centre - other.centre) > SHIFT * np.maximum(half, there)
        if (shifted | (half > SPREAD * there) | (there > SPREAD * half)).any():
            found.append(key)
    return found


def far_away(ours: Mapping[str, Spread | None], observed: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Keys whose observations (N, D) are farther from the statistics than any training data: how far.

    Where a dimension has hardly any spread, a few hundredths of its size count as one.
    """
    found = {}
    for key, values in observed.items():
        own = ours.get(key)
        if own is None or values.ndim != 2 or not values.size or own.half.shape != values.shape[1:]:
            continue
        half = np.maximum(own.half, np.maximum(WIDEST * np.abs(own.centre), 1e-2))
        z = np.median(np.abs(values - own.centre) / half, axis=0).max()
        if z > FAR:
            found[key] = float(z)
    return found
