"""Defaults that follow from the dataset: a chunk's length and spacing, and how chunks are executed.

Each choice is said in one line, with how to keep the preset's. None touches what was given, a policy that
goes on from a checkpoint, or ``preset=paper``, whose settings are LeRobot's.
"""

import logging
from collections.abc import Callable, Sequence
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
SPACING = 0.1  # time between two predictions [s]
STATES = (FeatureType.STATE, FeatureType.ENV)
EXECUTION = ("execution", "crossfade_steps")  # given, they are a choice of the mode


def _accept(config: ChunkedConfig) -> None:
    """Take a configuration as it is."""


def fit_to_dataset(
    config: ChunkedConfig, meta: Any, check: Callable[[ChunkedConfig], object] = _accept
) -> None:
    """Let a chunk's length, spacing and execution follow from the dataset, as far as nobody chose them.

    Args:
        config: of a policy that is trained from the beginning; changed in place.
        meta: LeRobot's metadata of the dataset.
        check: raises a `ConfigurationError` for a configuration whose chunks are of no use.
    """
    if config.given("preset") == "paper":
        return
    changes = _changes_are_asked_for(config, meta)
    fit_chunk(config, meta.fps, meta.episodes["length"], spaced=not changes, check=check)
    if changes:
        follow_the_newest(config)


def _changes_are_asked_for(config: ChunkedConfig, meta: Any) -> bool:
    inputs = config.input_features or {}
    states = [key for key, each in inputs.items() if each.type in STATES and key in meta.features]
    return bool(states) and dataset_asks_for_changes(Path(meta.root), meta.features, states)


def fit_chunk(
    config: ChunkedConfig,
    fps: float,
    episode_lengths: Sequence[int],
    *,
    spaced: bool = True,
    check: Callable[[ChunkedConfig], object] = _accept,
) -> None:
    """Lay predictions a tenth of a second apart, over the time of the preset's chunk or half an episode.

    A chunk stays as it is if its length was given, or if other given settings need it. With a given
    ``chunk_stride``, and with a preset that is made for it, every step stays predicted. LeRobot loads the
    actions of the preset's chunk before it makes the policy, so what is chosen lies within them.

    Args:
        config: changed in place.
        fps: of the dataset.
        episode_lengths: of all of its episodes [control steps].
        spaced: whether predictions may lie apart.
        check: as `fit_to_dataset` takes it.
    """
    name = config.length_name
    if any(config.given(each) is not None for each in (name, "horizon_s")) or config.chunk_stride != 1:
        return
    usual = getattr(config, name)
    spaced &= config.given("chunk_stride") is None and config.given("preset") in config.spaced_presets
    for stride in dict.fromkeys((spaced_stride(fps) if spaced else 1, 1)):
        length = fitting_length(usual, stride, fps, episode_lengths)
        chosen = {name: length, "chunk_stride": stride}
        if (length, stride) == (usual, 1):
            return
        if _is_usable(config, chosen, check):
            break
    else:
        return
    config.settle(**chosen)
    logger.warning(
        "%s=%d and chunk_stride=%d: predictions %.2g s apart over %.2g s, for %g fps and episodes of %g "
        "steps (--policy.%s=%d keeps the preset's)",
        name,
        length,
        stride,
        stride / fps,
        config.timing.control_steps / fps,
        fps,
        median(episode_lengths),
        name,
        usual,
    )


def spaced_stride(fps: float) -> int:
    """Control steps between two predictions that lie a tenth of a second apart."""
    return max(1, round(SPACING * fps))


def fitting_length(usual: int, stride: int, fps: float, episode_lengths: Sequence[int]) -> int:
    """How many predictions last as long as ``usual`` ones of every step do at 50 Hz, or half an episode.

    Args:
        usual: predictions of the preset, one for every step; no more control steps are covered.
        stride: control steps between two predictions.
        fps: control steps per second.
        episode_lengths: of all episodes [control steps].
    """
    most = min(usual, usual * fps / PRESETS_FPS, median(episode_lengths) * LARGEST_SHARE)
    grain = 5 if stride == 1 else 2  # so that queries and tokens can emit several actions each
    return max(grain, grain * int(most / stride / grain))


def _is_usable(
    config: ChunkedConfig, chosen: dict[str, int], check: Callable[[ChunkedConfig], object]
) -> bool:
    """Whether this chunk works, and LeRobot has loaded its actions for the preset's."""
    try:
        variant = config.variant(**chosen)
        check(variant)
    except ConfigurationError:
        return False
    steps, loaded = variant.action_delta_indices, config.action_delta_indices
    return steps[0] == loaded[0] and set(steps) <= set(loaded)


def follow_the_newest(config: ChunkedConfig) -> None:
    """Follow the newest chunk alone, because actions are changes of the state; not if a mode was given.

    Positions of two plans may be blended: each of them leads to where its plan goes. Changes must not: what
    an older plan asks for was computed for another state, and its errors add up.

    Args:
        config: changed in place.
    """
    if any(config.given(name) for name in EXECUTION) or config.n_action_steps == 1:
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
