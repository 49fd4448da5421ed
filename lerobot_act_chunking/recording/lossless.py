"""Camera frames between simulator and dataset: compressed on the fly, bit for bit.

A finished episode waits in the staging folder until it is its turn to be encoded into the dataset. Raw, one
640x480 camera would take 300 MB an episode; H.264 in its lossless RGB mode takes 3 % of that at 2 ms a frame.
"""

import io
from collections.abc import Iterator
from dataclasses import dataclass
from typing import cast

import av
import numpy as np
from av.video.stream import VideoStream


@dataclass(frozen=True)
class LosslessVideo:
    """``length`` frames of height x width x RGB, compressed without loss."""

    data: bytes
    length: int
    height: int
    width: int

    def frames(self) -> Iterator[np.ndarray]:
        """The frames in order, each (height, width, 3) uint8, decoded one at a time."""
        with av.open(io.BytesIO(self.data), "r") as container:
            for frame in container.decode(video=0):
                yield frame.to_ndarray(format="rgb24")


class LosslessEncoder:
    """Takes frames as they are rendered and holds only their compressed form.

    Args:
        height: of every frame [px].
        width: of every frame [px].
    """

    def __init__(self, height: int, width: int) -> None:
        self._height, self._width = height, width
        self._length = 0
        self._buffer = io.BytesIO()
        self._container = av.open(self._buffer, "w", format="matroska")
        # The rate is formal: frames are numbered, and come back in order.
        options = {"qp": "0", "preset": "ultrafast"}
        stream = cast(VideoStream, self._container.add_stream("libx264rgb", 50, options=options))
        stream.height, stream.width, stream.pix_fmt = height, width, "rgb24"
        stream.codec_context.thread_count = 1
        self._stream = stream

    def append(self, frame: np.ndarray) -> None:
        """Add one frame, (height, width, 3) uint8."""
        image = av.VideoFrame.from_ndarray(frame, format="rgb24")
        image.pts = self._length
        self._container.mux(self._stream.encode(image))
        self._length += 1

    def finish(self) -> LosslessVideo:
        """The frames so far; the encoder takes no more."""
        self._container.mux(self._stream.encode())
        self._container.close()
        return LosslessVideo(self._buffer.getvalue(), self._length, self._height, self._width)
