"""Defaults that follow from the dataset: how long a chunk is, and how chunks are executed.

Both say in one line what they chose and how to keep the preset's. Neither touches what was given, a policy
that goes on from a checkpoint, or ``preset=paper``, whose settings are LeRobot's.
"""

import logging
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

from lerobot.configs import FeatureType

from lerobot_act_chunking.data.action_kind import dataset_asks_for_changes
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.chunked_config import ChunkedConfig

logger = logging.getLogger(__name__)

PRESETS_FPS = 50  # control steps per second that the presets' lengths were chosen for
LARGEST_SHARE = 0.5  # of an episode that one chunk may cover; of one as long as the episode, half is padding
GRAIN = 5  # lengths are multiples of it, so that queries and tokens can emit several actions each
STATES = (FeatureType.STATE, FeatureType.ENV)
EXECUTION = ("execution", "crossfade_steps")  # given, they are a choice of the mode


def fit_to_dataset(config: ChunkedConfig, meta: Any) -> None:
    """Let the length and the execution of chunks follow from the dataset, as far as nobody chose them.

    Args:
        config: of a policy that is trained from the beginning; changed in place.
        meta: LeRobot's metadata of the dataset.
    """
    if config.given("preset") != "paper":
        fit_length(config, meta.fps, meta.episodes["length"])
        fit_execution(config, meta)


def fit_length(config: ChunkedConfig, fps: float, episode_lengths: Sequence[int]) -> None:
    """Give a chunk the time that it has at 50 Hz, or half an episode if that is less.

    It stays as it is if it was given, with a ``chunk_stride``, or if other given settings need it. It never
    grows, because LeRobot loads the actions of the preset's length before it makes the policy.

    Args:
        config: changed in place.
        fps: of the dataset.
        episode_lengths: of all of its episodes [control steps].
    """
    name = config.length_name
    if any(config.given(each) is not None for each in (name, "horizon_s")) or config.chunk_stride != 1:
        return
    usual = getattr(config, name)
    longest = min(usual * fps / PRESETS_FPS, median(episode_lengths) * LARGEST_SHARE)
    length = max(GRAIN, GRAIN * int(longest / GRAIN))
    if length >= usual or not _starts_alike(config, length):
        return
    config.settle(**{name: length})
    logger.warning(
        "%s=%d, %.2g s at the dataset's %g fps, because the default of %d is made for %d fps and longer "
        "episodes (--policy.%s=%d keeps it)",
        *(name, length, length / fps, fps, usual, PRESETS_FPS, name, usual),
    )


def _starts_alike(config: ChunkedConfig, length: int) -> bool:
    """Whether the shorter chunk works and is the beginning of the longer one, which LeRobot has loaded."""
    try:
        shorter = config.variant(**{config.length_name: length}).action_delta_indices
    except ConfigurationError:
        return False
    return shorter == config.action_delta_indices[: len(shorter)]


def fit_execution(config: ChunkedConfig, meta: Any) -> None:
    """Follow the newest chunk alone where actions are changes of the state.

    Positions of two plans may be blended: each of them leads to where its plan goes. Changes must not: what
    an older plan asks for was computed for another state, and its errors add up.

    Args:
        config: changed in place.
        meta: LeRobot's metadata of the dataset.
    """
    if any(config.given(name) for name in EXECUTION) or config.n_action_steps == 1:
        return
    inputs = config.input_features or {}
    states = [key for key, each in inputs.items() if each.type in STATES and key in meta.features]
    if not states or not dataset_asks_for_changes(Path(meta.root), meta.features, states):
        return
    usual = config.execution
    try:
        config.settle(execution="receding")
    except ConfigurationError:
        return
    logger.warning(
        "execution=receding, because the dataset's actions are changes of the state, and blended plans would "
        "add up their errors (--policy.execution=%s keeps the default)",
        usual,
    )
