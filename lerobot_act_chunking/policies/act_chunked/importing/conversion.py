"""The import of a checkpoint: read, convert, compare, write."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors
from lerobot.utils.constants import OBS_ENV_STATE, OBS_STATE
from torch import Tensor

from lerobot_act_chunking.compat import action_of
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig
from lerobot_act_chunking.policies.act_chunked.importing.formats import ActCheckpoint, read_checkpoint
from lerobot_act_chunking.policies.act_chunked.importing.statistics import choose_statistics
from lerobot_act_chunking.policies.act_chunked.importing.weights import WeightMap
from lerobot_act_chunking.policies.act_chunked.modeling_act_chunked import ActChunkedPolicy
from lerobot_act_chunking.policies.act_chunked.processor_act_chunked import (
    make_act_chunked_pre_post_processors,
)
from lerobot_act_chunking.policies.loading import LoadedPolicy, explained
from lerobot_act_chunking.policies.saving import check_absent, save_checkpoint

RESNETS = ("resnet18", "resnet34", "resnet50")
NORMALIZED = ("VISUAL", "STATE", "ENV", "ACTION")
# What the imported policy has of its own: where it goes, how it acts, what it is called.
NOT_CARRIED = {
    "use_peft",
    "push_to_hub",
    "repo_id",
    "pretrained_path",
    "pretrained_revision",
    "input_features",
    "normalization_mapping",
    "replace_final_stride_with_dilation",
    "n_action_steps",
    "temporal_ensemble_coeff",
}
TOLERANCE = 1e-5
"""Largest difference of an action that float32 explains, over the chunk's largest action (if above 1)."""


class Imported(NamedTuple):
    """An imported policy with its processors, and how far it is from the original.

    Attributes:
        loaded: the policy, in evaluation mode.
        difference: the largest between the two policies' chunks of a random batch, in normalised actions.
    """

    loaded: LoadedPolicy
    difference: float


def import_checkpoint(source: Path, output: Path, dataset: Path | None = None) -> Imported:
    """Make a checkpoint of LeRobot's ``act``, of any version, one of `act_chunked` that acts the same.

    Args:
        source: the checkpoint's folder (…/pretrained_model), which is only read.
        output: the folder to write; it appears complete or not at all.
        dataset: the LeRobotDataset it was trained on, for a checkpoint without statistics.

    Raises:
        ConfigurationError: naming what cannot be imported, or that the result would not act the same.
        DatasetError: if statistics are missing or not finite.
    """
    check_absent(output)
    check_source(source)
    checkpoint = read_checkpoint(source)
    statistics = choose_statistics(checkpoint, dataset)
    policy = convert(checkpoint)
    difference = compare(checkpoint, policy)
    if statistics is None:
        device = {"device_processor": {"device": str(policy.config.device)}}
        with explained(str(source)):
            processors = make_pre_post_processors(
                policy.config, pretrained_path=str(source), preprocessor_overrides=device
            )
    else:
        processors = make_act_chunked_pre_post_processors(policy.config, statistics)
    imported = Imported(LoadedPolicy(policy, *processors), difference)
    save_checkpoint(imported.loaded, output)
    return imported


def check_source(folder: Path) -> None:
    """Refuse what is no folder.

    Raises:
        ConfigurationError: saying how to get one, if it may be the name of a repository.
    """
    if not folder.is_dir():
        hint = f": download it first (hf download {folder} --local-dir act)" if len(folder.parts) == 2 else ""
        raise ConfigurationError(f"there is no folder {folder}{hint}")


def convert(checkpoint: ActCheckpoint) -> ActChunkedPolicy:
    """The policy with the checkpoint's settings and weights, in evaluation mode.

    Raises:
        ConfigurationError: naming a setting or weights that it does not have.
    """
    config = convert_settings(checkpoint.config)
    policy = ActChunkedPolicy(config, load_backbone_weights=False)
    try:
        policy.load_state_dict(WeightMap(checkpoint.weights, checkpoint.config).convert(), strict=True)
    except RuntimeError as error:  # sizes that the settings do not explain
        problem = " ".join(str(error).split())
        raise ConfigurationError(f"the weights do not fit the settings: {problem}") from error
    return policy.eval()


def convert_settings(config: ACTConfig) -> ActChunkedConfig:
    """The same settings as `act_chunked` writes them.

    Raises:
        ConfigurationError: naming a setting that it does not have.
    """
    features = {
        key: feature for key, feature in (config.input_features or {}).items() if _reads(key, feature)
    }
    if config.image_features and config.vision_backbone not in RESNETS:
        raise ConfigurationError(
            f"vision_backbone={config.vision_backbone} cannot be imported, only {', '.join(RESNETS)}"
        )
    if config.image_features and config.replace_final_stride_with_dilation:
        raise ConfigurationError(
            "replace_final_stride_with_dilation=true cannot be imported: act_chunked's backbones keep strides"
        )
    kept = {field.name: getattr(config, field.name) for field in fields(ACTConfig)}
    kept = {name: value for name, value in kept.items() if name not in NOT_CARRIED}
    modes = dict.fromkeys(NORMALIZED, NormalizationMode.IDENTITY) | config.normalization_mapping
    return ActChunkedConfig(
        preset="paper",
        push_to_hub=False,
        input_features=features,
        normalization_mapping=modes,
        **kept,
        **_execution(config),
    )


def _reads(key: str, feature: PolicyFeature) -> bool:
    """Whether LeRobot's act reads a feature; it silently ignores further vectors."""
    return feature.type is FeatureType.VISUAL or key in (OBS_STATE, OBS_ENV_STATE)


def _execution(config: ACTConfig) -> dict[str, Any]:
    """How LeRobot executes the chunks: each to its end, or all of them averaged."""
    coeff = config.temporal_ensemble_coeff
    if coeff is None or config.chunk_size == 1:
        return {"execution": "open_loop", "n_action_steps": config.n_action_steps}
    return {
        "execution": "ensemble",
        "replan_interval": 1,
        "temporal_ensemble_coeff": abs(coeff),
        "ensemble_weighting": "act" if coeff >= 0 else "recency",
    }


def compare(checkpoint: ActCheckpoint, ours: ActChunkedPolicy) -> float:
    """The largest difference between the chunks that both policies predict for a random batch.

    Raises:
        ConfigurationError: if it is more than rounding.
    """
    theirs = ACTPolicy(replace(checkpoint.config, pretrained_backbone_weights=None))
    theirs.load_state_dict(checkpoint.weights, strict=True)
    batch = _random_batch(checkpoint.config)
    expected = action_of(theirs.eval().predict_action_chunk(batch))
    actual = ours.predict_action_chunk(batch)
    difference = (actual - expected).abs().max().item()
    if not difference <= TOLERANCE * max(1.0, expected.abs().max().item()):
        raise ConfigurationError(
            f"the imported policy does not act as the original: actions differ by up to {difference:.2g}; "
            "nothing was written"
        )
    return difference


def _random_batch(config: ACTConfig) -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(0)
    unread = {OBS_STATE: torch.zeros(2, 1)}  # LeRobot's act looks there for its device, state or not
    return unread | {
        key: torch.randn(2, *feature.shape, generator=generator)
        for key, feature in (config.input_features or {}).items()
    }
