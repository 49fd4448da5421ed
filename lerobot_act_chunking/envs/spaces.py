"""Observation spaces of the simulated environments."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from lerobot_act_chunking.envs.options import ObservationOptions


def observation_space(
    options: ObservationOptions, states: Mapping[str, int], environment: int, limit: float = np.inf
) -> spaces.Dict:
    """What ``options.obs_type`` observes.

    Args:
        options: what is observed.
        states: names and sizes of the robot's vectors.
        environment: size of ``environment_state``.
        limit: largest value of all vectors.
    """

    def vector(size: int) -> spaces.Box:
        return spaces.Box(-limit, limit, (size,), np.float64)

    members: dict[str, spaces.Space[Any]] = {}
    if options.obs_type != "pixels":
        members |= {name: vector(size) for name, size in states.items()}
    if options.obs_type == "state":
        members["environment_state"] = vector(environment)
    else:
        image = spaces.Box(0, 255, (options.observation_height, options.observation_width, 3), np.uint8)
        members["pixels"] = spaces.Dict(dict.fromkeys(options.cameras, image))
    return spaces.Dict(members)
