"""Small random LeRobot datasets, and what it means for two items to be the same."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.testing
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from torch import Tensor

FPS = 10
LENGTHS = (5, 2, 7, 3)
REPO_ID = "tests/fast"

NUMBERS = {
    "observation.state": {"dtype": "float32", "shape": (6,), "names": None},
    "observation.precise": {"dtype": "float64", "shape": (3,), "names": None},
    "observation.grid": {"dtype": "float32", "shape": (2, 5), "names": None},
    "observation.tactile": {"dtype": "uint8", "shape": (2, 3, 4), "names": None},
    "observation.switches": {"dtype": "bool", "shape": (2,), "names": None},
    "counts": {"dtype": "int32", "shape": (2,), "names": None},
    "next.reward": {"dtype": "float32", "shape": (1,), "names": None},
    "next.done": {"dtype": "bool", "shape": (1,), "names": None},
    "label": {"dtype": "string", "shape": (1,), "names": None},
    "action": {"dtype": "float32", "shape": (4,), "names": None},
}
STATES = {key: NUMBERS[key] for key in ("observation.state", "next.reward", "action")}


def camera(dtype: str, height: int, width: int, channels: int = 3, **info: Any) -> dict[str, Any]:
    """A camera feature, stored as images or as video."""
    shape = (height, width, channels)
    return {"dtype": dtype, "shape": shape, "names": ["height", "width", "channels"], "info": info}


def draw(feature: dict[str, Any], rng: np.random.Generator) -> Any:
    """A random value of a feature, as ``add_frame`` wants it."""
    dtype, shape = feature["dtype"], feature["shape"]
    if dtype == "string":
        return "".join(rng.choice(list("abc"), 4))
    if dtype in ("image", "video"):
        depth = (feature["info"] or {}).get("is_depth_map")
        return rng.integers(0, 3000, shape, np.uint16) if depth else rng.integers(0, 256, shape, np.uint8)
    if dtype.startswith("float"):
        return rng.standard_normal(shape).astype(dtype)
    return rng.integers(0, 2 if dtype == "bool" else 200, shape).astype(dtype)


def record(
    root: Path,
    features: dict[str, Any],
    lengths: Iterable[int] = LENGTHS,
    value: Callable[..., Any] = draw,
    seed: int = 0,
    **options: Any,
) -> Path:
    """Writes a dataset of random episodes through LeRobot's own recorder; two tasks alternate."""
    dataset = LeRobotDataset.create(REPO_ID, FPS, features, root=root, video_backend="pyav", **options)
    rng = np.random.default_rng(seed)
    for episode, length in enumerate(lengths):
        for _ in range(length):
            frame = {key: value(feature, rng) for key, feature in features.items()}
            dataset.add_frame({**frame, "task": ("lift", "insert")[episode % 2]})
        dataset.save_episode()
    dataset.finalize()
    return root


def seconds(offsets: Iterable[int]) -> list[float]:
    """Frame offsets as LeRobot's delta timestamps."""
    return [offset / FPS for offset in offsets]


def batch(dataset: Any, indices: Iterable[int]) -> list[dict[str, Any]]:
    """Items as a DataLoader gets them, as plain dictionaries."""
    return [dict(item) for item in dataset.__getitems__(list(indices))]


def assert_same(ours: Any, theirs: Any) -> None:
    """Equal types, keys in equal order, dtypes, shapes, layout and values, at any depth."""
    assert type(ours) is type(theirs)
    if isinstance(theirs, dict):
        assert list(ours) == list(theirs)
        for key in theirs:
            assert_same(ours[key], theirs[key])
    elif isinstance(theirs, list):
        assert len(ours) == len(theirs)
        for mine, other in zip(ours, theirs, strict=True):
            assert_same(mine, other)
    elif isinstance(theirs, Tensor):
        assert (ours.dtype, ours.shape, ours.is_contiguous()) == (theirs.dtype, theirs.shape, True)
        torch.testing.assert_close(ours, theirs, rtol=0, atol=0, equal_nan=True)
    else:
        assert ours == theirs
