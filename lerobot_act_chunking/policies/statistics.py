"""Dataset statistics fit for normalisation: finite, complete, and with a least spread."""

from collections.abc import Mapping
from typing import Any, Protocol

import torch
from lerobot.configs import NormalizationMode, PolicyFeature

from lerobot_act_chunking.errors import DatasetError

Statistics = Mapping[str, Mapping[str, Any]]


class NormalizingConfig(Protocol):
    """The part of a policy's configuration that normalisation reads."""

    input_features: dict[str, PolicyFeature] | None
    output_features: dict[str, PolicyFeature] | None
    normalization_mapping: dict[str, NormalizationMode]


NEEDED = {
    NormalizationMode.IDENTITY: (),
    NormalizationMode.MEAN_STD: ("mean", "std"),
    NormalizationMode.MIN_MAX: ("min", "max"),
    NormalizationMode.QUANTILES: ("q01", "q99"),
    NormalizationMode.QUANTILE10: ("q10", "q90"),
}


def check_statistics(config: NormalizingConfig, stats: Statistics) -> None:
    """Refuse statistics that would normalise silently wrong.

    Raises:
        DatasetError: naming the feature and the statistic that is missing or not finite.
    """
    for key, name in _needed_statistics(config):
        if name not in stats.get(key, {}):
            raise DatasetError(f"the dataset has no statistic {name!r} of {key!r}, which normalises it")
        if not torch.isfinite(torch.as_tensor(stats[key][name])).all():
            raise DatasetError(
                f"statistic {name!r} of {key!r} is {stats[key][name]}: the dataset holds a NaN or an infinity"
            )


def floored_statistics(
    config: NormalizingConfig, stats: Statistics, floor: float
) -> dict[str, dict[str, Any]]:
    """A copy of ``stats`` in which no normalisation divides by less than ``floor`` (raw units).

    Scripted demonstrations hold some joints nearly still; divided by their tiny spread, a small deviation
    at run time becomes a huge input. The original ACT clips standard deviations at 1e-2; LeRobot does not.
    Ranges (min/max and quantiles) are widened about their centre to at least twice the floor, one floor to
    each side.

    Raises:
        DatasetError: as `check_statistics`.
    """
    check_statistics(config, stats)
    floored = {key: dict(values) for key, values in stats.items()}
    for key, names in _by_feature(config).items():
        values = {name: torch.as_tensor(stats[key][name], dtype=torch.float32) for name in names}
        if names == NEEDED[NormalizationMode.MEAN_STD]:
            values["std"] = values["std"].clamp_min(floor)
        elif names:
            low, high = names
            centre, half = (values[high] + values[low]) / 2, (values[high] - values[low]) / 2
            values = {low: centre - half.clamp_min(floor), high: centre + half.clamp_min(floor)}
        floored[key].update(values)
    return floored


def _by_feature(config: NormalizingConfig) -> dict[str, tuple[str, ...]]:
    features = {**(config.input_features or {}), **(config.output_features or {})}
    modes = config.normalization_mapping
    return {
        key: NEEDED[modes.get(feature.type.value, NormalizationMode.IDENTITY)]
        for key, feature in features.items()
    }


def _needed_statistics(config: NormalizingConfig) -> list[tuple[str, str]]:
    return [(key, name) for key, names in _by_feature(config).items() for name in names]
