"""What imported policies normalise by, where the checkpoint holds no processors of LeRobot's."""

from pathlib import Path
from typing import Any

import torch
from lerobot.configs import FeatureType
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.utils.constants import IMAGENET_STATS

from lerobot_act_chunking.data.actions import require_dataset
from lerobot_act_chunking.data.quiet import quiet_missing_ffmpeg
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.act_chunked.importing.formats import ActCheckpoint
from lerobot_act_chunking.policies.statistics import check_statistics, floored_statistics

NO_FLOOR = 0.0


def choose_statistics(checkpoint: ActCheckpoint, dataset: Path | None) -> dict[str, dict[str, Any]] | None:
    """Statistics of every normalised feature; None where LeRobot's processors bring their own.

    Args:
        checkpoint: whose own statistics are taken if it has any.
        dataset: the LeRobotDataset it was trained on, for a checkpoint without.

    Raises:
        ConfigurationError: if neither has them, or both.
        DatasetError: if they are incomplete or not finite, or the dataset cannot be read.
    """
    own = checkpoint.has_processors or checkpoint.statistics is not None
    if own and dataset is not None:
        raise ConfigurationError("the checkpoint brings its own normalisation: leave out --dataset")
    if checkpoint.has_processors:
        return None
    if not own and dataset is None:
        raise ConfigurationError(
            "the checkpoint holds neither LeRobot's processors (policy_preprocessor.json) nor statistics "
            "beside its weights: give the dataset that it was trained on with --dataset"
        )
    found = _of_dataset(dataset, checkpoint.config) if dataset is not None else checkpoint.statistics or {}
    check_statistics(checkpoint.config, found)
    return floored_statistics(checkpoint.config, found, NO_FLOOR)


def _of_dataset(folder: Path, config: ACTConfig) -> dict[str, dict[str, Any]]:
    """Statistics as LeRobot's training command takes them: cameras by ImageNet's, its default."""
    require_dataset(folder)
    quiet_missing_ffmpeg()
    stats = LeRobotDatasetMetadata(f"local/{folder.name}", root=folder).stats or {}
    imagenet = {name: torch.tensor(value) for name, value in IMAGENET_STATS.items()}
    cameras = [
        key for key, feature in (config.input_features or {}).items() if feature.type is FeatureType.VISUAL
    ]
    return {key: dict(values) for key, values in stats.items()} | dict.fromkeys(cameras, imagenet)
