"""Metadata of a dataset whose rate, lengths and kind of actions are given."""

from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from policy_case import STATE, A


def meta_of(folder, *, changes=False, fps=10, lengths=(47, 50, 55)):
    """Metadata of a dataset, in a folder, whose actions are positions or changes of the state."""
    rng = np.random.default_rng(0)
    (width,) = STATE["observation.state"].shape
    speeds = np.repeat(rng.normal(size=(40, width)), 5, axis=0)
    states = np.cumsum(speeds, axis=0)
    actions = (speeds if changes else states)[1:, :A]
    (folder / "data").mkdir(parents=True, exist_ok=True)
    rows = {
        "observation.state": list(states[:-1]),
        "action": list(actions),
        "episode_index": [0] * len(actions),
    }
    pq.write_table(pa.table(rows), folder / "data" / "file.parquet")
    features = {
        "observation.state": {"dtype": "float32", "shape": (width,)},
        "action": {"dtype": "float32", "shape": (A,)},
    }
    numbers = {"observation.state": states[:-1], "action": actions}
    stats = {
        key: {"mean": each.mean(0), "std": each.std(0), "min": each.min(0), "max": each.max(0)}
        for key, each in numbers.items()
    }
    return SimpleNamespace(
        root=folder, fps=fps, features=features, episodes={"length": list(lengths)}, stats=stats,
        repo_id="local/planted", camera_keys=[],
    )  # fmt: skip
