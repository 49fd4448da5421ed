"""What worlds have in common that this package does not know: LeRobot's configuration, and recording."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig

Row = Sequence[Any]


@dataclass
class StateWorldConfig(EnvConfig):
    """A world without cameras, for LeRobot; others say which one, and its ``features``."""

    features_map: dict = field(
        default_factory=lambda: {
            "action": "action",
            "agent_pos": "observation.state",
            "environment_state": "observation.environment_state",
        }
    )


def state_features(action: int, state: int, environment: int) -> dict[str, PolicyFeature]:
    """``features`` of a world with so many numbers of each."""
    return {
        "action": PolicyFeature(FeatureType.ACTION, (action,)),
        "agent_pos": PolicyFeature(FeatureType.STATE, (state,)),
        "environment_state": PolicyFeature(FeatureType.ENV, (environment,)),
    }


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
