"""Checkpoints of LeRobot's ``act``, whatever version of LeRobot wrote them.

=============  ===================================  ==============================================
LeRobot        ``config.json``                      normalisation statistics
=============  ===================================  ==============================================
first, 2024    ``input_shapes``, one mode per       buffers in ``model.safetensors``
               feature, no ``type``
to 0.3         ``input_features``, one mode per     buffers in ``model.safetensors``
               type of feature
from 0.4       the same                             ``policy_preprocessor.json`` and its state
=============  ===================================  ==============================================
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import draccus
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.utils.constants import (
    ACTION,
    OBS_ENV_STATE,
    OBS_STATE,
    POLICY_POSTPROCESSOR_DEFAULT_NAME,
    POLICY_PREPROCESSOR_DEFAULT_NAME,
)
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.json_files import read_json

Statistics = dict[str, dict[str, Tensor]]

PROCESSORS = tuple(
    f"{name}.json" for name in (POLICY_PREPROCESSOR_DEFAULT_NAME, POLICY_POSTPROCESSOR_DEFAULT_NAME)
)
BUFFERS = ("normalize_inputs.buffer_", "normalize_targets.buffer_", "unnormalize_outputs.buffer_")
FIRST_NAMES = {"model.encoder_robot_and_latent_pos_embed.": "model.encoder_1d_feature_pos_embed."}


@dataclass(frozen=True)
class ActCheckpoint:
    """What a checkpoint holds, in the names of LeRobot 0.6.

    Attributes:
        config: the settings.
        weights: state dict of ``ACTPolicy``.
        statistics: of the features, from buffers beside the weights; None if there are none.
        has_processors: whether LeRobot's processors lie beside the weights.
    """

    config: ACTConfig
    weights: dict[str, Tensor]
    statistics: Statistics | None
    has_processors: bool


def read_checkpoint(folder: Path) -> ActCheckpoint:
    """Read a checkpoint of LeRobot's ``act``, of any version.

    Args:
        folder: …/pretrained_model.

    Raises:
        ConfigurationError: a file is missing or damaged, the policy is another one, or a setting is unknown.
    """
    settings = _read_settings(folder)
    if "input_shapes" in settings:
        settings = modern_settings(settings)
    config = _parse(folder, settings)
    present = [name for name in PROCESSORS if (folder / name).is_file()]
    if len(present) == 1:
        (missing,) = set(PROCESSORS) - set(present)
        raise ConfigurationError(f"{folder} holds {present[0]}, but no {missing}")
    weights, statistics = _split(_read_weights(folder / "model.safetensors"), config)
    return ActCheckpoint(config, weights, statistics, bool(present))


def _read_settings(folder: Path) -> dict[str, Any]:
    try:
        settings = read_json(_file(folder, "config.json"))
    except ValueError as error:
        raise ConfigurationError(f"{folder / 'config.json'} is damaged: {error}") from error
    if not isinstance(settings, dict):
        raise ConfigurationError(f"{folder / 'config.json'} holds no settings, but {settings!r:.40}")
    of_first_version = {"input_shapes", "n_vae_encoder_layers"} <= settings.keys()
    policy_type = settings.pop("type", "act" if of_first_version else None)
    if policy_type != "act":
        raise ConfigurationError(
            f"{folder} holds a policy of type {policy_type}: only LeRobot's act can become act_chunked"
        )
    return settings


def _file(folder: Path, name: str) -> Path:
    if not (folder / name).is_file():
        adapter = (folder / "adapter_model.safetensors").is_file()
        hint = "; it is an adapter: merge it into its policy first" if adapter else ""
        raise ConfigurationError(f"{folder} holds no {name}{hint}")
    return folder / name


def modern_settings(first: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of LeRobot's first versions in today's names.

    Raises:
        ConfigurationError: if they ask for what today's cannot say: an ensemble by momentum, or features of
            one type with different normalisations.
    """
    settings = dict(first)
    momentum = settings.pop("temporal_ensemble_momentum", None)
    if momentum is not None:
        raise ConfigurationError(
            f"temporal_ensemble_momentum={momentum}: this moving average is no temporal ensemble and was "
            "dropped by LeRobot; set it to null in a copy of the checkpoint's config.json, then choose an "
            "execution for the imported policy"
        )
    modes: dict[str, str] = {}
    for side in ("input", "output"):
        shapes, features = settings.pop(f"{side}_shapes"), {}
        normalizations = settings.pop(f"{side}_normalization_modes", {})
        for key, shape in shapes.items():
            features[key] = {"type": _type_of(key), "shape": shape}
        settings[f"{side}_features"] = features
        for key, mode in normalizations.items():
            if modes.setdefault(_type_of(key), mode.upper()) != mode.upper():
                raise ConfigurationError(
                    f"{key!r} is normalised by {mode}, another feature of its type by "
                    f"{modes[_type_of(key)].lower()}: LeRobot now knows one mode per type"
                )
    return {**settings, "normalization_mapping": modes}


def _type_of(key: str) -> str:
    """The type of a feature, by its name."""
    if key.startswith("observation.image"):
        return "VISUAL"
    types = {OBS_STATE: "STATE", OBS_ENV_STATE: "ENV", ACTION: "ACTION"}
    if key not in types:
        raise ConfigurationError(f"LeRobot's act has no feature called {key!r}")
    return types[key]


def _parse(folder: Path, settings: dict[str, Any]) -> ACTConfig:
    unknown = settings.keys() - {field.name for field in fields(ACTConfig)}
    if unknown:
        raise ConfigurationError(
            f"{folder / 'config.json'} holds settings that LeRobot's act lacks: {', '.join(sorted(unknown))}"
        )
    try:
        config = draccus.decode(ACTConfig, settings)
        config.validate_features()
    except Exception as error:  # draccus hides what LeRobot's own checks say
        cause = error.__cause__ or error.__context__ or error
        raise ConfigurationError(f"LeRobot refuses the settings of {folder}: {cause}") from error
    return config


def _read_weights(file: Path) -> dict[str, Tensor]:
    try:
        return load_file(_file(file.parent, file.name))
    except SafetensorError as error:
        raise ConfigurationError(f"{file} is damaged: {error}") from error


def _split(weights: dict[str, Tensor], config: ACTConfig) -> tuple[dict[str, Tensor], Statistics | None]:
    """Weights without the buffers of normalisation, and what these hold."""
    features = {**(config.input_features or {}), **(config.output_features or {})}
    keys = {key.replace(".", "_"): key for key in features}
    network, statistics = {}, {}
    for name, value in weights.items():
        prefix = next((prefix for prefix in BUFFERS if name.startswith(prefix)), None)
        feature, _, statistic = name.removeprefix(prefix or "").rpartition(".")
        if prefix is not None and feature in keys:
            statistics.setdefault(keys[feature], {})[statistic] = value
        else:
            network[_today(name)] = value
    return network, statistics or None


def _today(name: str) -> str:
    for before, now in FIRST_NAMES.items():
        name = name.replace(before, now)
    return name
