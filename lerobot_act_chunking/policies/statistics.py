"""Dataset statistics fit for normalisation: complete, sound, and with a least spread."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from torch import Tensor

from lerobot_act_chunking.errors import DatasetError

Statistics = Mapping[str, Mapping[str, Any]]


class NormalizingConfig(Protocol):
    """The part of a policy's configuration that normalisation reads."""

    input_features: dict[str, PolicyFeature] | None
    output_features: dict[str, PolicyFeature] | None
    normalization_mapping: dict[str, NormalizationMode]


RECOMPUTE = (
    "Make a copy of the dataset with new statistics: lerobot-edit-dataset --operation.type=recompute_stats "
    "(with its --repo_id and --root)"
)
NEEDED = {
    NormalizationMode.MEAN_STD: ("mean", "std"),
    NormalizationMode.MIN_MAX: ("min", "max"),
    NormalizationMode.QUANTILES: ("q01", "q99"),
    NormalizationMode.QUANTILE10: ("q10", "q90"),
}


@dataclass
class Normalised:
    """The part of a policy's configuration that normalisation reads, of chosen features."""

    input_features: dict[str, PolicyFeature] | None
    output_features: dict[str, PolicyFeature] | None
    normalization_mapping: dict[str, NormalizationMode]


def check_statistics(config: NormalizingConfig, stats: Statistics) -> None:
    """Refuse statistics of the policy's features that nothing can be normalised by.

    Only those that the normalisation in use divides by or subtracts are looked at; those that are absent are
    for `floored_statistics` to refuse.

    Raises:
        DatasetError: naming the feature, the statistic and what is wrong with it.
    """
    features = _features(config)
    for key, names in needed_statistics(config).items():
        given = stats.get(key, {})
        numbers = {name: _numbers(key, name, given[name]) for name in names if name in given}
        for name, value in numbers.items():
            _check_size(key, name, value, features[key])
        if "std" in numbers and (numbers["std"] < 0).any():
            raise DatasetError(f"statistic 'std' of {key!r} is {given['std']}: a spread below 0. {RECOMPUTE}")
        if len(numbers) == 2 and "std" not in numbers and (numbers[names[0]] > numbers[names[1]]).any():
            low, high = (f"{name!r} of {key!r} is {given[name]}" for name in names)
            raise DatasetError(f"statistic {low}, above {high}. {RECOMPUTE}")


def _numbers(key: str, name: str, value: Any) -> Tensor:
    """A statistic as finite real numbers."""
    try:
        numbers = torch.as_tensor(value)
    except (TypeError, ValueError, RuntimeError):
        numbers = None
    if numbers is None or numbers.is_complex() or numbers.dtype == torch.bool:
        raise DatasetError(f"statistic {name!r} of {key!r} is {value!r}: no real number. {RECOMPUTE}")
    if not torch.isfinite(numbers).all():
        raise DatasetError(
            f"statistic {name!r} of {key!r} is {value}: the dataset holds a NaN or an infinity there, or did "
            f"when they were computed. {RECOMPUTE}"
        )
    return numbers


def _check_size(key: str, name: str, numbers: Tensor, feature: PolicyFeature) -> None:
    """Refuse what LeRobot would silently spread over dimensions that it does not belong to."""
    expected = math.prod(feature.shape)
    if feature.type is not FeatureType.VISUAL and numbers.numel() != expected:
        raise DatasetError(
            f"statistic {name!r} of {key!r} has {numbers.numel()} numbers, but the policy has {expected} "
            f"dimensions there. {RECOMPUTE}"
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
    for key, names in needed_statistics(config).items():
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


def needed_statistics(config: NormalizingConfig) -> dict[str, tuple[str, str]]:
    """The two statistics that each of the policy's features is normalised by, if it is."""
    modes = config.normalization_mapping
    identity = NormalizationMode.IDENTITY
    needed = {key: modes.get(feature.type.value, identity) for key, feature in _features(config).items()}
    return {key: NEEDED[mode] for key, mode in needed.items() if mode is not identity}


def _features(config: NormalizingConfig) -> dict[str, PolicyFeature]:
    return {**(config.input_features or {}), **(config.output_features or {})}
