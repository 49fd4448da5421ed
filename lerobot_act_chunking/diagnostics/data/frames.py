"""Pictures of a dataset, in shades of grey, one after the other."""

from collections.abc import Iterator
from fractions import Fraction
from itertools import islice
from pathlib import Path

import av
import numpy as np
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_act_chunking.errors import DatasetError


def cameras_of(meta: LeRobotDatasetMetadata) -> list[str]:
    """Keys of all cameras whose pictures have a colour or a brightness, and no depth."""
    features = meta.features
    return [
        key for key in meta.camera_keys if not (features[key].get("info") or {}).get("video.is_depth_map")
    ]


def grey_frames(
    meta: LeRobotDatasetMetadata, key: str, episode: int, first: int, n: int
) -> Iterator[np.ndarray]:
    """Up to n frames (H, W) uint8 of an episode.

    Args:
        meta: of the dataset.
        key: of the camera.
        episode: LeRobot's index.
        first: frame of the episode to begin with.
        n: how many.

    Raises:
        DatasetError: the pictures are absent or damaged.
    """
    read = _of_video if key in meta.video_keys else _of_images
    try:
        yield from islice(read(meta, key, episode, first), n)
    except Exception as error:  # whatever PyAV, Pillow and LeRobot raise on damaged files
        raise DatasetError(
            f"the pictures of {key!r} in episode {episode} of {meta.root} cannot be read ({error!r}): "
            "restore them, or look at the numbers alone: --cameras none"
        ) from error


def _of_video(meta: LeRobotDatasetMetadata, key: str, episode: int, first: int) -> Iterator[np.ndarray]:
    row = meta.episodes[episode]  # pyright: ignore[reportOptionalSubscript]  (there are episodes)
    begin = row[f"videos/{key}/from_timestamp"] + first / meta.fps
    with av.open(str(Path(meta.root) / meta.get_video_file_path(episode, key))) as container:
        stream = container.streams.video[0]
        base = stream.time_base or Fraction(1, int(meta.fps))
        container.seek(max(0, round(begin / base) - 1), backward=True, stream=stream)
        for frame in container.decode(stream):
            if frame.pts is not None and float(frame.pts * base) > begin - 0.5 / meta.fps:
                yield frame.to_ndarray(format="gray")


def _of_images(meta: LeRobotDatasetMetadata, key: str, episode: int, first: int) -> Iterator[np.ndarray]:
    rows = LeRobotDataset(meta.repo_id, root=meta.root, episodes=[episode]).hf_dataset.with_format(None)
    for row in range(first, len(rows)):
        yield np.asarray(rows[row][key].convert("L"))
