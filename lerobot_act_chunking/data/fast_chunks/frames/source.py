"""The frames of a batch: those of the cache, and for the others LeRobot's decoder."""

import logging
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Int64, UInt8
from lerobot.datasets.dataset_reader import DatasetReader
from torch import Tensor

from lerobot_act_chunking.data.fast_chunks.columns import Column
from lerobot_act_chunking.data.fast_chunks.frames.cache import open_stores
from lerobot_act_chunking.data.fast_chunks.frames.store import FrameStore, frame_shape
from lerobot_act_chunking.nn.image_view import Size, resize

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Moments:
    """Which frames of a camera are asked for: T of each of B items."""

    index: Int64[np.ndarray, "B T"]
    timestamps: Sequence[Sequence[float]]

    @classmethod
    def of_rows(cls, columns: Mapping[str, Column], rows: Int64[np.ndarray, "B T"]) -> "Moments":
        """The frames of these rows of the dataset's table."""
        return cls(columns["index"].take(rows), columns["timestamp"].gather(rows).tolist())


class Frames:
    """What training reads of a dataset's videos: bytes, resized where that is asked for.

    Args:
        reader: LeRobot's, which decodes to bytes.
        cameras: keys of videos.
        size: (height, width) of the frames; None for the videos' own.
        n_frames: that will be read of each camera.

    ``stores_more`` turns false in a process that could not store a frame.
    """

    def __init__(self, reader: DatasetReader, cameras: Sequence[str], size: Size | None, n_frames: int):
        features: Any = reader._meta.features
        self.size = size
        self.shapes = {key: frame_shape(features[key]["shape"], size) for key in cameras}
        self.stores: dict[str, FrameStore] = open_stores(reader, cameras, size, n_frames)
        self.stores_more = True

    @property
    def cameras(self) -> Collection[str]:
        """Their keys."""
        return self.shapes.keys()

    def gather(
        self,
        reader: DatasetReader,
        episodes: Int64[np.ndarray, " B"],
        moments: Mapping[str, Moments],
    ) -> dict[str, UInt8[Tensor, "B T 3 h w"]]:
        """The frames of each camera.

        Args:
            reader: LeRobot's, which decodes what is not stored.
            episodes: of the items.
            moments: what is asked for, by camera.
        """
        frames = {
            key: np.empty((*asked.index.shape, *self.shapes[key]), np.uint8) for key, asked in moments.items()
        }
        for item, episode in enumerate(episodes.tolist()):
            absent = {
                key: places
                for key, asked in moments.items()
                if (places := self._copy_stored(key, asked.index[item], frames[key][item]))
            }
            if absent:
                stamps = {key: [moments[key].timestamps[item][t] for t in at] for key, at in absent.items()}
                for key, decoded in reader._query_videos(stamps, episode).items():
                    pixels = self._resized(decoded).numpy()
                    frames[key][item, absent[key]] = pixels
                    self._store(key, moments[key].index[item, absent[key]], pixels)
        return {key: torch.from_numpy(value) for key, value in frames.items()}

    def _copy_stored(
        self, key: str, index: Int64[np.ndarray, " T"], into: UInt8[np.ndarray, "T 3 h w"]
    ) -> list[int]:
        """Copy what is stored; returns the places of what is not."""
        if key not in self.stores:
            return list(range(len(index)))
        absent = []
        for place, frame in enumerate(index.tolist()):
            stored = self.stores[key].read(frame)
            if stored is None:
                absent.append(place)
            else:
                into[place] = stored
        return absent

    def _resized(self, decoded: UInt8[Tensor, "*T 3 H W"]) -> UInt8[Tensor, "T 3 h w"]:
        frames = decoded.reshape(-1, *decoded.shape[-3:])  # LeRobot squeezes a single frame
        return frames if self.size is None else resize(frames, self.size)

    def _store(self, key: str, index: Int64[np.ndarray, " n"], pixels: UInt8[np.ndarray, "n 3 h w"]) -> None:
        """Keep frames; a full disk ends that for this process."""
        if key not in self.stores or not self.stores_more:
            return
        try:
            for frame, each in zip(index.tolist(), pixels, strict=True):
                self.stores[key].write(frame, each)
        except OSError as error:
            self.stores_more = False
            logger.warning("no more decoded frames are stored, those that are stay in use: %s", error)

    def missing(self, index: Int64[np.ndarray, " n"]) -> dict[str, Int64[np.ndarray, " m"]]:
        """Of each camera with a store, those of these frames that are not in it."""
        return {key: store.missing(index) for key, store in self.stores.items()}
