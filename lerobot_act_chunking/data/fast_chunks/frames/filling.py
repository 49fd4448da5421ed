"""Decoding ahead, in a process of its own, while training runs: in order, which is several times as fast.

The process has low priority, says how far it is, and ends with the one that started it. Frames that training
needs before they are there are decoded and stored by training itself.
"""

import argparse
import atexit
import json
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import torch
from filelock import FileLock, Timeout
from jaxtyping import Int64
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_act_chunking.data.fast_chunks.columns import Column, numeric_columns
from lerobot_act_chunking.data.fast_chunks.frames.source import Frames, Moments

FEW = 256  # missing frames that training has decoded before another process has started
AT_ONCE = 32  # consecutive frames
SAY_EVERY_S = 15.0
NICE = 10

logger = logging.getLogger(__name__)


def fill_in_background(dataset: LeRobotDataset, frames: Frames) -> None:
    """Start to decode what is missing of a dataset; it ends with this process, if not before.

    Args:
        dataset: as LeRobot opened it.
        frames: the source whose stores are filled.
    """
    if not frames.stores:
        return
    reader: Any = dataset.reader
    index = reader.hf_dataset.data.column("index").to_numpy()
    n_missing = max(len(each) for each in frames.missing(index).values())
    logger.info(
        "frames are cached in %s: %d of %d are there%s",
        _first_folder(frames).parent,
        len(index) - n_missing,
        len(index),
        ", the others follow in the background" if n_missing > FEW else "",
    )
    if n_missing > FEW:
        settings = {
            "repo_id": dataset.repo_id,
            "root": str(dataset.root),
            "episodes": dataset.episodes,
            "tolerance_s": reader._tolerance_s,
            "video_backend": reader._video_backend,
        }
        options = {"dataset": settings, "cameras": list(frames.stores), "size": frames.size}
        arguments = [json.dumps(options), "--parent", str(os.getpid())]
        process = subprocess.Popen([sys.executable, "-m", __name__, *arguments])  # noqa: S603
        atexit.register(_end, process)


def _end(process: subprocess.Popen) -> None:
    process.terminate()
    process.wait()


def fill(options: dict[str, Any], parent: int) -> None:
    """Decode all frames of a dataset that are missing, episode by episode, as long as ``parent`` lives."""
    dataset = LeRobotDataset(**options["dataset"], return_uint8=True)
    reader: Any = dataset.reader
    columns = numeric_columns(reader.hf_dataset)
    n_frames = len(reader.hf_dataset)
    size = None if options["size"] is None else tuple(options["size"])
    frames = Frames(reader, options["cameras"], size, n_frames)
    if not frames.stores:
        return
    alone = FileLock(_first_folder(frames) / "filling.lock", blocking=False)
    with suppress(Timeout), alone:  # or somebody else fills the same stores
        _fill_all(frames, reader, columns, lambda: os.getppid() == parent and frames.stores_more)


def _fill_all(frames: Frames, reader: Any, columns: dict[str, Column], wanted: Callable[[], bool]) -> None:
    """Decode and store, as long as that is ``wanted``."""
    n_frames, done, said = len(reader.hf_dataset), 0, time.monotonic()
    for rows in _pieces(columns["episode_index"].take(np.arange(n_frames))):
        if not wanted():
            return
        _store(frames, reader, columns, rows)
        done += len(rows)
        if time.monotonic() - said > SAY_EVERY_S:
            said = time.monotonic()
            logger.info("frame cache: %d of %d frames (%.0f %%)", done, n_frames, 100 * done / n_frames)
    logger.info("frame cache: complete, %d frames", n_frames)


def _first_folder(frames: Frames) -> Path:
    return next(iter(frames.stores.values())).folder


def _store(frames: Frames, reader: Any, columns: dict[str, Column], rows: Int64[np.ndarray, " n"]) -> None:
    """Decode those of these neighbouring rows that are missing, of each camera."""
    index = columns["index"].take(rows)
    moments = {
        key: Moments.of_rows(columns, rows[np.isin(index, missing)][None])
        for key, missing in frames.missing(index).items()
        if missing.size
    }
    if moments:
        frames.gather(reader, columns["episode_index"].take(rows[:1]), moments)


def _pieces(episodes: Int64[np.ndarray, " n"]) -> Iterator[Int64[np.ndarray, " m"]]:
    """Rows in their order, a few at once, none of two episodes."""
    starts = np.flatnonzero(np.diff(episodes)) + 1
    for rows in np.split(np.arange(len(episodes)), starts):
        yield from np.split(rows, range(AT_ONCE, len(rows), AT_ONCE))


def main() -> None:
    """What the process does."""
    parser = argparse.ArgumentParser()
    parser.add_argument("options", type=json.loads)
    parser.add_argument("--parent", type=int)
    given = parser.parse_args()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the training, which ends this process
    os.nice(NICE)
    torch.set_num_threads(1)
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(asctime)s %(message)s")
    logger.setLevel(logging.INFO)
    fill(given.options, given.parent)


if __name__ == "__main__":
    main()
