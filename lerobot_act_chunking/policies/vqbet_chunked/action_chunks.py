"""Chunks of demonstrated actions, normalised as a policy's processors do it."""

from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from lerobot.processor import (
    NormalizerProcessorStep,
    TransitionKey,
    UnnormalizerProcessorStep,
    create_transition,
)
from lerobot.utils.constants import ACTION
from torch import Tensor

from lerobot_act_chunking.data.actions import Demonstrations, episode_starts
from lerobot_act_chunking.data.fast_chunks.windows import EpisodeWindows
from lerobot_act_chunking.data.masking import hold_padding
from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.policies.statistics import (
    NEEDED,
    Normalised,
    check_statistics,
    floored_statistics,
)


class ActionChunks:
    """Normalised chunks from every step of every episode on, as a policy's processors make them.

    Args:
        demonstrations: the actions.
        timing: of the chunks.
        mode: how actions are normalised.
        floor: least spread in the statistics (``norm_std_floor``).

    Attributes:
        names: of the action dimensions.
        ranges: of each, between its smallest and its largest raw value.
        longest_episode: its length [control steps].

    Raises:
        DatasetError: the dataset lacks the statistics to normalise by, or they are not finite.
    """

    def __init__(
        self, demonstrations: Demonstrations, timing: ChunkTiming, mode: NormalizationMode, floor: float
    ):
        self.names = demonstrations.names
        self.ranges = (demonstrations.actions.amax(0) - demonstrations.actions.amin(0)).tolist()
        self._needed = NEEDED.get(mode, ())
        actions = {ACTION: PolicyFeature(FeatureType.ACTION, (len(demonstrations.names),))}
        config = Normalised({}, actions, {"ACTION": mode})
        check_statistics(config, demonstrations.stats)
        self._stats = floored_statistics(config, demonstrations.stats, floor)
        how: Any = {
            "features": actions,
            "norm_map": {FeatureType.ACTION: mode},
            "stats": {ACTION: self._stats.get(ACTION, {})},
        }
        self._unnormalize = UnnormalizerProcessorStep(**how)
        self._actions = _apply(NormalizerProcessorStep(**how), demonstrations.actions)
        starts = episode_starts(demonstrations.episode)
        ends = np.append(starts[1:], len(demonstrations.episode))
        self.longest_episode = int((ends - starts).max())
        self._episode = np.repeat(np.arange(len(starts)), ends - starts)
        self._windows = EpisodeWindows(starts, ends, None)
        self._offsets = np.asarray(timing.action_deltas)

    def __len__(self) -> int:
        return len(self._actions)

    @property
    def statistics(self) -> dict[str, list[float]]:
        """The two statistics that normalise, floored."""
        stats = self._stats.get(ACTION, {})
        return {name: torch.as_tensor(stats[name], dtype=torch.float32).tolist() for name in self._needed}

    def take(self, rows: Int64[np.ndarray, " N"]) -> tuple[Float[Tensor, "N C A"], Bool[Tensor, "N C"]]:
        """The chunks from these steps on, and their padding, which holds the last action before it."""
        places, is_pad = self._windows.rows(rows, self._episode[rows], self._offsets)
        padding = torch.from_numpy(is_pad)
        return hold_padding(self._actions[torch.from_numpy(places)], padding), padding

    def raw(self, chunks: Float[Tensor, "N C A"]) -> Float[Tensor, "N C A"]:
        """Chunks in the units of the dataset."""
        return _apply(self._unnormalize, chunks)


def _apply(step: Any, actions: Tensor) -> Tensor:
    return step(create_transition(action=actions))[TransitionKey.ACTION]
