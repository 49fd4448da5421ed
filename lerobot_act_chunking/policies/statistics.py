"""Dataset statistics fit for normalisation: finite, complete, and with a least spread."""

from collections.abc import Mapping
from typing import Any, Protocol

import torch
from lerobot.configs import NormalizationMode, PolicyFeature
from torch import Tensor

from lerobot_act_chunking.errors import DatasetError

Statistics = Mapping[str, Mapping[str, Any]]


class NormalizingConfig(Protocol):
    """The part of a policy's configuration that normalisation reads."""

    input_features: dict[str, PolicyFeature] | None
    output_features: dict[str, PolicyFeature] | None
    normalization_mapping: dict[str, NormalizationMode]


NEEDED = {
    NormalizationMode.MEAN_STD: ("mean", "std"),
    NormalizationMode.MIN_MAX: ("min", "max"),
    NormalizationMode.QUANTILES: ("q01", "q99"),
    NormalizationMode.QUANTILE10: ("q10", "q90"),
}


def check_finite(config: NormalizingConfig, stats: Statistics) -> None:
    """Refuse statistics of the policy's features that a NaN or an infinity in the dataset has spoiled.

    Raises:
        DatasetError: naming the feature and the statistic.
    """
    for key in _features(config):
        for name, value in stats.get(key, {}).items():
            if not torch.isfinite(torch.as_tensor(value)).all():
                raise DatasetError(
                    f"statistic {name!r} of {key!r} is {value}: the dataset holds a NaN or an infinity"
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
        DatasetError: naming a feature without statistics, which LeRobot would silently leave as it is.
    """
    floored = {key: dict(values) for key, values in stats.items()}
    for key, names in _needed_statistics(config).items():
        if missing := set(names) - set(stats.get(key, ())):
            raise DatasetError(
                f"the dataset has no {' or '.join(sorted(missing))} of {key!r} to normalise it by"
            )
        floored[key].update(_floored(stats[key], names, floor))
    return floored


def _floored(values: Mapping[str, Any], names: tuple[str, str], floor: float) -> dict[str, Tensor]:
    first, second = (torch.as_tensor(values[name], dtype=torch.float32) for name in names)
    if names == ("mean", "std"):
        return {"std": second.clamp_min(floor)}
    centre, half = (second + first) / 2, ((second - first) / 2).clamp_min(floor)
    return dict(zip(names, (centre - half, centre + half), strict=True))


def _needed_statistics(config: NormalizingConfig) -> dict[str, tuple[str, str]]:
    modes = config.normalization_mapping
    identity = NormalizationMode.IDENTITY
    needed = {key: modes.get(feature.type.value, identity) for key, feature in _features(config).items()}
    return {key: NEEDED[mode] for key, mode in needed.items() if mode is not identity}


def _features(config: NormalizingConfig) -> dict[str, PolicyFeature]:
    return {**(config.input_features or {}), **(config.output_features or {})}
