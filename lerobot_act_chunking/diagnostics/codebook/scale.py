"""The normalisation that a tokenizer was trained with."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import torch
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from lerobot.processor import (
    NormalizerProcessorStep,
    ProcessorStep,
    TransitionKey,
    UnnormalizerProcessorStep,
    create_transition,
)
from lerobot.utils.constants import ACTION
from torch import Tensor

from lerobot_act_chunking.policies.loading import LoadedPolicy


@dataclass(frozen=True)
class ActionScale:
    """Actions in raw units to normalised ones and back, by LeRobot's own processor steps."""

    normalizer: NormalizerProcessorStep
    unnormalizer: UnnormalizerProcessorStep

    @classmethod
    def of_policy(cls, policy: LoadedPolicy) -> Self:
        """What the checkpoint's processors do to actions."""
        steps = (*policy.preprocessor.steps, *policy.postprocessor.steps)
        (normalizer,) = (step for step in steps if isinstance(step, NormalizerProcessorStep))
        (unnormalizer,) = (step for step in steps if isinstance(step, UnnormalizerProcessorStep))
        return cls(normalizer, unnormalizer)

    @classmethod
    def of_statistics(cls, mode: NormalizationMode, statistics: Mapping[str, Any], action_dim: int) -> Self:
        """LeRobot's normalisation ``mode`` by these statistics, such as ``mean`` and ``std`` (A,)."""
        stats = {ACTION: {name: torch.as_tensor(value) for name, value in statistics.items()}}
        features = {ACTION: PolicyFeature(FeatureType.ACTION, (action_dim,))}
        settings: dict[str, Any] = {
            "features": features,
            "norm_map": {FeatureType.ACTION: mode},
            "stats": stats,
        }
        return cls(NormalizerProcessorStep(**settings), UnnormalizerProcessorStep(**settings))

    def normalised(self, actions: np.ndarray) -> Tensor:
        """Normalised actions (..., A), on the CPU, from raw ones."""
        return _apply(self.normalizer, torch.as_tensor(actions, dtype=torch.float32))

    def raw(self, actions: Tensor) -> np.ndarray:
        """Raw actions (..., A) from normalised ones."""
        return _apply(self.unnormalizer, actions.cpu()).numpy()


def _apply(step: ProcessorStep, actions: Tensor) -> Tensor:
    transition: Any = step(create_transition(action=actions))
    return transition[TransitionKey.ACTION]
