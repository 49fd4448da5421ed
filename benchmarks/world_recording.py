"""Demonstrations in worlds that this package's recorder does not know, as a LeRobotDataset."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

Row = Sequence[Any]


def write_demonstrations(
    folder: Path,
    fps: int,
    names: Mapping[str, list[str]],
    demonstrations: Iterable[tuple[str, Sequence[Row]]],
) -> None:
    """Write all steps of all demonstrations.

    Args:
        folder: of the dataset, which is not there yet.
        fps: control steps a second.
        names: of the numbers of each feature.
        demonstrations: each an instruction and a list of steps, with a vector for each feature.
    """
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    features = {
        key: {"dtype": "float32", "shape": (len(each),), "names": each} for key, each in names.items()
    }
    dataset = LeRobotDataset.create(f"local/{folder.name}", fps=fps, features=features, root=folder)
    for task, rows in demonstrations:
        for row in rows:
            frame = {key: np.asarray(value, np.float32) for key, value in zip(names, row, strict=True)}
            dataset.add_frame({**frame, "task": task})
        dataset.save_episode()
    dataset.finalize()
