"""Demonstrations as a policy's training sees them."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int64
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.datasets.factory import resolve_delta_timestamps
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from torch.utils.data import DataLoader, Subset

from lerobot_act_chunking.data.actions import episode_starts, require_dataset
from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset
from lerobot_act_chunking.data.quiet import quiet_missing_ffmpeg
from lerobot_act_chunking.diagnostics.core.compatibility import OTHER_DATASET, check_features, check_rate
from lerobot_act_chunking.diagnostics.core.episodes import evenly
from lerobot_act_chunking.errors import DatasetError, FeatureError

AT_ONCE = 256


@dataclass(frozen=True)
class Samples:
    """Observations with action chunks, evenly spread over a dataset.

    Attributes:
        folder: of the dataset.
        rows: (N,) frames, in order.
        episode: (N,) index of the episode of each.
        progress: (N,) place in it, from 0 to 1.
    """

    folder: str
    dataset: LeRobotDataset
    rows: Int64[np.ndarray, " N"]
    episode: Int64[np.ndarray, " N"]
    progress: Float[np.ndarray, " N"]

    def __len__(self) -> int:
        return len(self.rows)

    def every(self, step: int) -> "Samples":
        """The first of each ``step`` samples."""
        kept = slice(None, None, step)
        return Samples(self.folder, self.dataset, self.rows[kept], self.episode[kept], self.progress[kept])

    def batches(self) -> Iterator[dict[str, Any]]:
        """Raw batches, in order."""
        yield from DataLoader(Subset(self.dataset, self.rows.tolist()), batch_size=AT_ONCE)


def read_samples(folder: str, config: Any, most: int, starts_of: Collection[int] | None = None) -> Samples:
    """Open a LeRobotDataset for a policy.

    Args:
        folder: where it is.
        config: the policy's configuration.
        most: how many samples to take; fewer if there are not as many.
        starts_of: take the first frames of these episodes alone.

    Raises:
        DatasetError: there is no dataset, or it is damaged or empty.
        FeatureError: it lacks what the policy needs, or has another shape of it.
    """
    path = Path(folder)
    require_dataset(folder)
    quiet_missing_ffmpeg()
    name = f"local/{path.name}"
    try:
        meta = LeRobotDatasetMetadata(name, root=path)
        shapes = {key: feature["shape"] for key, feature in meta.features.items()}
        check_features(config, shapes, f"the dataset at {folder}", OTHER_DATASET)
        check_rate(getattr(config, "fps", None), meta.fps, f"the dataset at {folder}", OTHER_DATASET)
        deltas = resolve_delta_timestamps(config, meta)
        dataset = FastChunkDataset(name, root=path, delta_timestamps=deltas)
        episode = np.asarray(dataset.hf_dataset.with_format("numpy")["episode_index"][:], np.int64)
    except FeatureError:
        raise
    except Exception as error:  # whatever LeRobot and its parsers raise on damaged files
        raise DatasetError(f"the dataset at {folder} cannot be read: {error!r}") from error
    if not episode.size:
        raise DatasetError(f"the dataset at {folder} holds no episodes")
    rows = np.arange(len(episode))
    if starts_of is not None:
        rows = episode_starts(episode)
        rows = rows[np.isin(episode[rows], list(starts_of))]
    rows = rows[evenly(len(rows), most)]
    return Samples(folder, dataset, rows, episode[rows], _progress(episode)[rows])


def _progress(episode: Int64[np.ndarray, " F"]) -> Float[np.ndarray, " F"]:
    """Place of each frame in its episode, from 0 to 1."""
    starts = episode_starts(episode)
    lengths = np.diff([*starts, len(episode)])
    step = np.arange(len(episode)) - np.repeat(starts, lengths)
    return step / np.maximum(np.repeat(lengths, lengths) - 1, 1)
