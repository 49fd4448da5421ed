"""What a policy is shown where episodes start."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from lerobot.envs.configs import EnvConfig
from lerobot.envs.utils import preprocess_observation

from lerobot_act_chunking.diagnostics.core.worlds import open_worlds

MOST_IMAGES = 16


@dataclass(frozen=True)
class Starts:
    """First observations of episodes, as they come to the policy's processors.

    Attributes:
        vectors: (N, D) by key.
        images: (M, 3, height, width) by key, of the first episodes.
    """

    vectors: dict[str, np.ndarray]
    images: dict[str, np.ndarray]


def observe_starts(env_config: EnvConfig, policy_config: Any, seeds: Sequence[int]) -> Starts:
    """Start episodes without playing them.

    Args:
        env_config: of the environment.
        policy_config: of the policy, for the environment's own processors.
        seeds: of the episodes.
    """
    worlds = open_worlds(env_config, 1, policy_config)
    vectors: dict[str, list[np.ndarray]] = {}
    images: dict[str, list[np.ndarray]] = {}
    try:
        (env,) = worlds.envs
        for place, seed in enumerate(seeds):
            raw, _ = env.reset(seed=seed, options=worlds.reset_options)
            for key, value in worlds.before(preprocess_observation(_batch_of_one(raw))).items():
                if not isinstance(value, torch.Tensor):
                    continue
                if value.ndim == 2:
                    vectors.setdefault(key, []).append(value[0].cpu().double().numpy())
                elif value.ndim == 4 and place < MOST_IMAGES:
                    images.setdefault(key, []).append(value[0].cpu().float().numpy())
    finally:
        worlds.close()
    return Starts(
        {key: np.stack(rows) for key, rows in vectors.items()},
        {key: np.stack(rows) for key, rows in images.items()},
    )


def _batch_of_one(observation: dict[str, Any]) -> dict[str, Any]:
    return {
        key: _batch_of_one(value) if isinstance(value, dict) else np.asarray(value)[None]
        for key, value in observation.items()
    }
