"""Small recorded datasets with columns of any kind."""

from pathlib import Path
from typing import Any

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

STATE, FORCE, ENV = "observation.state", "observation.force", "observation.environment_state"
TOP, SIDE = "observation.images.top", "observation.images.side"
KINDS = {
    "text": ({"dtype": "string", "shape": (1,), "names": None}, lambda _: "reach"),
    "bool": ({"dtype": "bool", "shape": (2,), "names": None}, lambda step: np.array([step % 2 == 0, True])),
    "int": ({"dtype": "int64", "shape": (3,), "names": None}, lambda step: np.array([step, 1, 2])),
    "NaN": (
        {"dtype": "float32", "shape": (2,), "names": None},
        lambda step: np.array([step, np.nan if step == 7 else 1], np.float32),
    ),
}


def vector(size):
    return {"dtype": "float32", "shape": (size,), "names": None}


def record(root: Path, extra: dict[str, tuple[dict, Any]]) -> Path:
    """Two episodes of waves, with columns besides: their feature, and their value at a step."""
    features = {
        "action": vector(4),
        STATE: vector(6),
        **{key: feature for key, (feature, _) in extra.items()},
    }
    dataset = LeRobotDataset.create("tests/read", 10, features, root=root, use_videos=False)
    for length in (12, 9):
        for step in range(length):
            wave = {key: np.sin(np.arange(size) + step / 5) for key, size in (("action", 4), (STATE, 6))}
            numbers = {key: value.astype(np.float32) for key, value in wave.items()}
            more = {key: value(step) for key, (_, value) in extra.items()}
            dataset.add_frame({**numbers, **more, "task": "do"})
        dataset.save_episode()
    dataset.finalize()
    return root


def images(keys: tuple[str, ...]) -> dict[str, tuple[dict, Any]]:
    feature = {"dtype": "image", "shape": (32, 40, 3), "names": ["height", "width", "channels"]}
    return {key: (feature, lambda step: np.full((32, 40, 3), step, np.uint8)) for key in keys}
