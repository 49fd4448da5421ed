"""A source of episodes that costs nothing, and what its datasets are compared with."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lerobot_act_chunking.recording.episode import DatasetFormat, Episode
from lerobot_act_chunking.recording.lossless import LosslessEncoder

STATE, ACTION, HEIGHT, WIDTH = 3, 2, 16, 24


@dataclass(frozen=True)
class FakeSource:
    """Random numbers from the seed; seeds can be told to fail, to be broken, or to kill their process."""

    camera: bool = False
    failing: tuple[int, ...] = ()
    not_finite: tuple[int, ...] = ()
    raising: tuple[int, ...] = ()
    deadly: tuple[int, ...] = ()
    log: Path | None = None
    """Gets one line per attempt."""
    variant: str = "plain"
    version: str = "1.0"

    @property
    def format(self) -> DatasetFormat:
        features = {
            "observation.state": {"dtype": "float32", "shape": (STATE,), "names": ["x", "y", "z"]},
            "action": {"dtype": "float32", "shape": (ACTION,), "names": ["dx", "dy"]},
        }
        if self.camera:
            names = ["height", "width", "channels"]
            features["observation.images.eye"] = {
                "dtype": "video",
                "shape": (HEIGHT, WIDTH, 3),
                "names": names,
            }
        return DatasetFormat(fps=10, task="Do nothing.", robot_type="fake", features=features)

    @property
    def settings(self) -> dict[str, object]:
        return {"source": "fake", "variant": self.variant}

    @property
    def versions(self) -> dict[str, str]:
        return {"fake": self.version}

    @contextmanager
    def open(self) -> Iterator[Callable[[int], Episode]]:
        yield self.play

    def play(self, seed: int) -> Episode:
        if self.log is not None:
            with self.log.open("a") as file:
                file.write(f"{seed}\n")
        if seed in self.deadly:
            import os

            os._exit(9)
        if seed in self.raising:
            raise RuntimeError(f"seed {seed} is cursed")
        rng = np.random.default_rng(seed)
        length = 5 + seed % 3
        arrays = {
            "observation.state": rng.normal(size=(length, STATE)).astype(np.float32),
            "action": rng.normal(size=(length, ACTION)).astype(np.float32),
        }
        if seed in self.not_finite:
            arrays["action"][4, 1] = np.nan
        videos = {"observation.images.eye": film(rng, length)} if self.camera else {}
        return Episode(seed, seed not in self.failing, arrays, videos, {"mood": "calm"})


def film(rng: np.random.Generator, length: int):
    encoder = LosslessEncoder(HEIGHT, WIDTH)
    start = rng.integers(0, 200)
    for t in range(length):
        frame = np.full((HEIGHT, WIDTH, 3), start + 5 * t, np.uint8)
        encoder.append(frame)
    return encoder.finish()


def files(root: Path) -> dict[str, bytes]:
    """Everything in a dataset: recordings are equal when these are."""
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}
