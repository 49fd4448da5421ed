"""What is recorded: one episode, the dataset it belongs to, and where episodes come from."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.recording.lossless import LosslessVideo


@dataclass(frozen=True)
class DatasetFormat:
    """The shape of a LeRobotDataset.

    Attributes:
        fps: control rate [Hz], also that of the videos.
        task: instruction stored with every frame.
        robot_type: LeRobot's free name for the robot.
        features: LeRobot's feature table: {name: {"dtype": "float32" | "video", "shape", "names"}}; the shape
            of a video is (height, width, 3).
    """

    fps: int
    task: str
    robot_type: str
    features: Mapping[str, dict[str, Any]]

    @property
    def arrays(self) -> dict[str, dict[str, Any]]:
        """The features stored as numbers."""
        return {name: entry for name, entry in self.features.items() if entry["dtype"] != "video"}

    @property
    def videos(self) -> dict[str, dict[str, Any]]:
        """The features stored as video."""
        return {name: entry for name, entry in self.features.items() if entry["dtype"] == "video"}


@dataclass(frozen=True)
class Episode:
    """One attempt of T control periods.

    Attributes:
        seed: everything random in the episode follows from it.
        success: whether the attempt is worth recording.
        arrays: {feature: (T, *shape) float32}.
        videos: {feature: T frames}.
        details: anything JSON can hold, kept with the episode in the dataset's metadata.
        task: its instruction, where it is not the dataset's.
    """

    seed: int
    success: bool
    arrays: dict[str, np.ndarray]
    videos: dict[str, LosslessVideo] = field(default_factory=dict)
    details: dict[str, Any] = field(default_factory=dict)
    task: str | None = None

    def __len__(self) -> int:
        return len(next(iter(self.arrays.values())))


class EpisodeSource(Protocol):
    """Anything that turns seeds into episodes: an expert in a simulator, for one.

    A source is pickled into worker processes, so it describes and ``open`` builds. The same seed gives the
    same episode, bit for bit, in any process and after any other episode.
    """

    @property
    def format(self) -> DatasetFormat:
        """The dataset that the episodes make up."""
        ...

    @property
    def settings(self) -> dict[str, Any]:
        """What the episodes depend on, as JSON: sources with equal settings give equal episodes."""
        ...

    @property
    def versions(self) -> dict[str, str]:
        """Versions of the packages the episodes depend on."""
        ...

    def open(self) -> AbstractContextManager[Callable[[int], Episode]]:
        """Build the simulator; inside the context, ``play(seed)`` runs one episode."""
        ...


def check_episode(episode: Episode, form: DatasetFormat) -> None:
    """Refuse an episode that would make a damaged dataset.

    Raises:
        DatasetError: features missing or unknown, a wrong shape or type, or a value that is not finite; names
            the seed, the feature, the frame and the entry.
    """
    given = {*episode.arrays, *episode.videos}
    if given != set(form.features):
        raise DatasetError(
            f"the episode of seed {episode.seed} has the features {sorted(given)}, "
            f"the dataset {sorted(form.features)}"
        )
    for name, entry in form.arrays.items():
        _check_array(episode, name, entry)
    for name, entry in form.videos.items():
        _check_video(episode, name, entry)


def _check_array(episode: Episode, name: str, entry: dict[str, Any]) -> None:
    array = episode.arrays[name]
    expected = (len(episode), *entry["shape"])
    if array.shape != expected or array.dtype != entry["dtype"]:
        raise DatasetError(
            f"{name} of seed {episode.seed} is {array.dtype} {array.shape}, "
            f"expected {entry['dtype']} {expected}"
        )
    if np.isfinite(array).all():
        return
    frame, *entries = (int(i) for i in np.argwhere(~np.isfinite(array))[0])
    where = entry["names"][entries[0]] if entry.get("names") and len(entries) == 1 else entries
    raise DatasetError(
        f"{name} of seed {episode.seed} is {array[frame, *entries]} at frame {frame}, entry {where}; "
        "the episode is not recorded"
    )


def _check_video(episode: Episode, name: str, entry: dict[str, Any]) -> None:
    video = episode.videos[name]
    shape = (video.length, video.height, video.width, 3)
    expected = (len(episode), *entry["shape"])
    if shape != expected:
        raise DatasetError(f"{name} of seed {episode.seed} has frames {shape}, expected {expected}")
