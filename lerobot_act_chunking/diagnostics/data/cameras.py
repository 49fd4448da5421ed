"""Cameras that show nothing, freeze, or deliver a picture more than once."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

from lerobot_act_chunking.diagnostics.core.episodes import evenly
from lerobot_act_chunking.diagnostics.core.recording import Episode
from lerobot_act_chunking.diagnostics.data.dimensions import longest_run
from lerobot_act_chunking.diagnostics.data.frames import grey_frames

BLANK = 3.0
"""Standard deviation within a picture [grey levels] below which there is nothing to see in it."""
TILE = 16
"""Edge of the squares by which pictures are compared [px]: a camera's noise is averaged out in them."""
STILL = 1.0
"""Change of every square [grey levels] below which nothing has moved in a picture."""
MOST_EPISODES, MOST_FRAMES = 8, 150
"""Of a sample: so many episodes, evenly spread, and so many frames in the middle of each."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class CameraEpisode:
    """What a camera showed in an episode.

    Attributes:
        episode: LeRobot's index.
        frames: that were looked at.
        blank: share of them in which there is nothing to see.
        repeated: share that equal the one before to the bit.
        still: share of the steps in which the robot moved, but no part of the picture changed.
        longest_still_s: how long that lasted at most.
    """

    episode: int
    frames: int
    blank: float
    repeated: float
    still: float
    longest_still_s: float


@dataclass(frozen=True)
class Camera:
    """One camera.

    Attributes:
        key: LeRobot's.
        episodes: those that were looked at.
    """

    key: str
    episodes: tuple[CameraEpisode, ...]

    @property
    def repeated(self) -> float:
        """Share of repeated frames in the median episode."""
        return float(np.median([each.repeated for each in self.episodes]))


def look(
    meta: LeRobotDatasetMetadata,
    keys: Sequence[str],
    episodes: Sequence[Episode],
    moving: Sequence[np.ndarray],
    *,
    sample: bool,
    progress: Progress | None = None,
) -> list[Camera]:
    """Compare each frame with the one before.

    Args:
        meta: of the dataset.
        keys: of the cameras.
        episodes: of the dataset.
        moving: (L - 1,) of each episode: whether the robot moves in the step.
        sample: whether some frames of some episodes are enough.
        progress: called with the number of frames compared and planned.

    Raises:
        DatasetError: pictures are absent or damaged.
    """
    chosen = evenly(len(episodes), MOST_EPISODES) if sample else range(len(episodes))
    spans = {each: _span(len(episodes[each]), sample) for each in chosen}
    planned, done = len(keys) * sum(n for _, n in spans.values()), 0
    cameras = []
    for key in keys:
        found = []
        for each, (first, n) in spans.items():
            index, motion = episodes[each].index, moving[each][first : first + n - 1]
            found.append(compare(grey_frames(meta, key, index, first, n), index, motion, meta.fps))
            done += n
            if progress is not None:
                progress(done, planned)
        cameras.append(Camera(key, tuple(found)))
    return cameras


def _span(frames: int, sample: bool) -> tuple[int, int]:
    """First frame and number of those in the middle of an episode."""
    n = min(frames, MOST_FRAMES) if sample else frames
    return (frames - n) // 2, n


def compare(frames: Iterable[np.ndarray], episode: int, moving: np.ndarray, fps: float) -> CameraEpisode:
    """What a camera showed.

    Args:
        frames: N pictures (H, W) in shades of grey, in order.
        episode: LeRobot's index.
        moving: (N - 1,) whether the robot moves between two of them.
        fps: frames per second.
    """
    blank: list[bool] = []
    repeated: list[bool] = []
    still: list[bool] = []
    before = None
    for frame in frames:
        blank.append(bool(frame.std() < BLANK))
        tiles = _tiles(frame)
        if before is not None:
            repeated.append(np.array_equal(frame, before[0]))
            still.append(bool(np.abs(tiles - before[1]).max() < STILL))
        before = frame, tiles
    unmoved = np.array(still, bool) & moving[: len(still)]
    return CameraEpisode(
        episode=episode,
        frames=len(blank),
        blank=float(np.mean(blank)) if blank else 0.0,
        repeated=sum(repeated) / max(1, len(blank)),
        still=float(unmoved.sum() / max(1, moving.sum())),
        longest_still_s=longest_run(unmoved) / fps,
    )


def _tiles(frame: np.ndarray) -> np.ndarray:
    """Mean brightness of each square; of the whole picture where it is smaller than one."""
    height, width = (size // TILE * TILE for size in frame.shape)
    if not height or not width:
        return frame.mean(keepdims=True)
    squares = frame[:height, :width].reshape(height // TILE, TILE, width // TILE, TILE)
    return squares.mean((1, 3))
