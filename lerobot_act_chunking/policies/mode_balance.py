"""Losses in which rare ways of doing a task count as much as frequent ones."""

import logging
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.data.actions import episode_starts, read_demonstrations
from lerobot_act_chunking.data.episode_modes import clustered_modes, mode_weights, require_recorded_modes
from lerobot_act_chunking.errors import DatasetError, FeatureError
from lerobot_act_chunking.policies.chunked_config import ChunkedConfig

EPISODE = "episode_index"

logger = logging.getLogger(__name__)


class ModeBalance(nn.Module):
    """Multiplies each sample's loss by the weight of its episode; the mean weight of a dataset is 1.

    It has no weights that are trained or saved: they follow from the dataset, also in a resumed run.

    Args:
        weights: of each episode, by its index.
    """

    def __init__(self, weights: Float[Tensor, " E"]):
        super().__init__()
        self.weights: Tensor
        self.register_buffer("weights", weights, persistent=False)

    @classmethod
    def of_dataset(cls, config: ChunkedConfig, meta: Any) -> Self:
        """The weights that a configuration asks for.

        Args:
            config: with ``balance_modes`` other than ``none``.
            meta: LeRobot's metadata of the dataset.

        Raises:
            DatasetError: modes that are not recorded of every episode, or actions that cannot be read.
        """
        lengths = dict(enumerate(meta.episodes["length"]))
        modes = _modes(config.balance_modes, Path(meta.root))
        missing = sorted(lengths.keys() - modes.keys())
        if missing:
            raise DatasetError(
                f"the mode of episode {missing[0]} of the dataset at {meta.root} is not known: set "
                "--policy.balance_modes=clusters, or none"
            )
        weights = mode_weights(
            {each: modes[each] for each in lengths}, lengths, float(config.mode_balance_power)
        )
        _say(config, {each: modes[each] for each in lengths}, weights)
        return cls(torch.tensor([weights[each] for each in lengths], dtype=torch.float32))

    def forward(self, loss: Float[Tensor, " B"], batch: Mapping[str, Any]) -> Float[Tensor, " B"]:
        """The losses times their weights.

        Raises:
            FeatureError: the batch does not say which episodes its samples are from.
        """
        episode = batch.get(EPISODE)
        if not isinstance(episode, Tensor) or episode.numel() != len(loss):
            raise FeatureError(
                f"balance_modes needs {EPISODE!r} of every sample, as LeRobot's datasets give it: set "
                "--policy.balance_modes=none to learn from other batches"
            )
        return loss * self.weights[episode.reshape(-1).to(self.weights.device)].to(loss)


def _modes(kind: str, folder: Path) -> dict[int, int]:
    """The mode of each episode by its index."""
    if kind == "labels":
        return require_recorded_modes(folder)
    found = read_demonstrations(folder)
    starts = episode_starts(found.episode)
    labels = clustered_modes(np.split(found.actions.numpy(), starts[1:]))
    return dict(zip(found.episode[starts].tolist(), labels.tolist(), strict=True))


def _say(config: ChunkedConfig, modes: Mapping[int, int], weights: Mapping[int, float]) -> None:
    counts = Counter(modes.values())
    if len(counts) == 1:
        logger.warning(
            "balance_modes=%s found one way of doing it: all demonstrations weigh the same",
            config.balance_modes,
        )
        return
    by_mode = {modes[episode]: weight for episode, weight in weights.items()}
    told = ", ".join(f"{counts[mode]} episodes weigh {by_mode[mode]:.2g}" for mode in sorted(counts))
    logger.warning("balance_modes=%s: %d modes, %s", config.balance_modes, len(counts), told)
