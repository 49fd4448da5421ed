"""Demonstrated actions, episode by episode."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lerobot.utils.constants import ACTION

from lerobot_act_chunking.data.actions import episode_starts, read_demonstrations
from lerobot_act_chunking.diagnostics.core.training import dataset_fps
from lerobot_act_chunking.errors import DatasetError


@dataclass(frozen=True)
class ActionEpisodes:
    """The actions of a dataset.

    Attributes:
        folder: where it lies.
        fps: control steps per second.
        names: of the action's dimensions.
        episodes: actions (L, A) in raw units by episode.
    """

    folder: str
    fps: float
    names: Sequence[str]
    episodes: dict[int, np.ndarray]

    def only(self, episodes: Sequence[int]) -> "ActionEpisodes":
        """These episodes alone, as far as there are any."""
        kept = {each: self.episodes[each] for each in episodes if each in self.episodes}
        return ActionEpisodes(self.folder, self.fps, self.names, kept)


def read_episodes(folder: str) -> ActionEpisodes:
    """The actions of a LeRobotDataset; nothing else of it is read.

    Raises:
        DatasetError: there is none, it is damaged or empty, or an action is not finite.
    """
    found = read_demonstrations(Path(folder))
    actions = found.actions.numpy()
    if not len(actions):
        raise DatasetError(f"the dataset at {folder} holds no episodes")
    if not np.isfinite(actions).all():
        (first, *_), _ = np.nonzero(~np.isfinite(actions))
        raise DatasetError(
            f"{ACTION!r} of the dataset at {folder} is not finite in episode "
            f"{found.episode[first]}: leave that out"
        )
    fps = dataset_fps(folder)
    if fps is None:
        raise DatasetError(f"{folder}/meta/info.json has no control rate (fps) above 0")
    starts = episode_starts(found.episode)
    by_episode = zip(found.episode[starts], np.split(actions, starts[1:]), strict=True)
    return ActionEpisodes(folder, fps, found.names, {int(each): rows for each, rows in by_episode})


def evenly(n: int, most: int) -> np.ndarray:
    """Indices (min(n, most),) evenly spread from 0 to n - 1; all if there are no more than ``most``."""
    return np.linspace(0, n - 1, min(n, most)).round().astype(int)
