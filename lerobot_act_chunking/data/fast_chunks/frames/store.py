"""One camera's frames in one file, shared by all processes that read them."""

import json
import os
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int64, UInt8

from lerobot_act_chunking.durable_files import publish, remove, scratch_path
from lerobot_act_chunking.json_files import read_json
from lerobot_act_chunking.nn.image_view import Size

DESCRIPTION, FRAMES, SUMS = "description.json", "frames.uint8", "checksums.uint32"
LEAST_SUM = 1  # 0 stands for a frame that is not there


@dataclass(frozen=True)
class FrameStore:
    """Frames (n_frames, *shape) of a camera, as bytes, and a checksum for each that is there.

    The file has its full length from the start, and holes where no frame was written. Reading maps it into
    memory; writing does not, because a full disk is an error there and the end of the process here. Two
    processes that write the same frame write the same bytes. A checksum is written behind its frame and is
    looked at once by every process, so that what a crash left half written counts as absent.

    Attributes:
        folder: of the files.
        shape: (3, h, w).
        n_frames: of the whole dataset.
    """

    folder: Path
    shape: tuple[int, int, int]
    n_frames: int

    @property
    def frame_bytes(self) -> int:
        """Size of one frame."""
        return int(np.prod(self.shape))

    def prepare(self, content: dict[str, Any]) -> None:
        """Make the files, unless they are there and belong to this content; call this under a lock.

        Raises:
            OSError: the disk does not allow it.
        """
        if not self._is_sound(content):
            remove(self.folder)
            with scratch_path(self.folder.parent) as scratch:
                scratch.mkdir()
                for name, size in self._sizes.items():
                    with (scratch / name).open("xb") as file:
                        file.truncate(size)
                (scratch / DESCRIPTION).write_text(json.dumps(content, indent=1))
                publish(scratch, self.folder)
        os.utime(self.folder / DESCRIPTION)  # what has not been used for longest goes first

    def _is_sound(self, content: dict[str, Any]) -> bool:
        try:
            sizes = {name: (self.folder / name).stat().st_size for name in self._sizes}
            return sizes == self._sizes and read_json(self.folder / DESCRIPTION) == content
        except (OSError, ValueError):
            return False

    @property
    def _sizes(self) -> dict[str, int]:
        return {FRAMES: self.n_frames * self.frame_bytes, SUMS: self.n_frames * 4}

    @cached_property
    def _frames(self) -> UInt8[np.ndarray, "n 3 h w"]:
        return np.asarray(np.memmap(self.folder / FRAMES, np.uint8, "r", shape=(self.n_frames, *self.shape)))

    @cached_property
    def _sums(self) -> np.ndarray:
        return np.asarray(np.memmap(self.folder / SUMS, np.uint32, "r", shape=(self.n_frames,)))

    @cached_property
    def _checked(self) -> np.ndarray:
        return np.zeros(self.n_frames, bool)

    def missing(self, frames: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " m"]:
        """Those of these frames that were never stored."""
        return frames[self._sums[frames] == 0]

    def read(self, frame: int) -> UInt8[np.ndarray, "3 h w"] | None:
        """A view of a frame; None if it is not there, or damaged."""
        expected = self._sums[frame]
        if expected == 0:
            return None
        stored = self._frames[frame]
        if not self._checked[frame]:
            if checksum(stored) != expected:
                return None
            self._checked[frame] = True
        return stored

    def write(self, frame: int, pixels: UInt8[np.ndarray, "3 h w"]) -> None:
        """Store a frame.

        Raises:
            OSError: the disk is full, or somebody has deleted the files.
        """
        content = np.ascontiguousarray(pixels)
        for name, offset, value in (
            (FRAMES, frame * self.frame_bytes, content),
            (SUMS, frame * 4, np.uint32(checksum(content))),
        ):
            with (self.folder / name).open("r+b") as file:
                file.seek(offset)
                file.write(value.tobytes())

    def __getstate__(self) -> dict[str, Any]:
        """Without the maps: every process makes its own."""
        return asdict(self)


def frame_shape(recorded: Sequence[int], size: Size | None) -> tuple[int, int, int]:
    """Shape (3, h, w) of frames that were recorded as (height, width, 3), at their own or another size."""
    height, width, channels = recorded
    return (channels, *(size or (height, width)))


def checksum(pixels: UInt8[np.ndarray, "3 h w"]) -> int:
    """A number from 1 to 2**32 - 1."""
    return max(LEAST_SUM, zlib.crc32(pixels))
