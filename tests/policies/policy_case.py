"""A small policy of some type and inputs, and what a type's tests have to know of it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.policies.factory import get_policy_class
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor

B, T, A = 3, 5, 4
STATE = {"observation.state": PolicyFeature(FeatureType.STATE, (6,))}
VELOCITY = {"observation.velocity": PolicyFeature(FeatureType.STATE, (2,))}
ENVIRONMENT = {"observation.environment_state": PolicyFeature(FeatureType.ENV, (7,))}
TOP = {"observation.images.top": PolicyFeature(FeatureType.VISUAL, (3, 32, 48))}
WRIST = {"observation.images.wrist": PolicyFeature(FeatureType.VISUAL, (3, 32, 32))}


@dataclass(frozen=True)
class Kind:
    """What the contract's tests have to know of a policy type.

    Attributes:
        sizes: settings of a network that is built and trained in no time.
        larger: settings with which it learns eight samples by heart, without what makes their loss noisy.
        n_training_steps: optimiser steps for that; generative policies have more to learn.
        noise: arguments that make a sampling policy predict the same chunks whatever else is in the batch.
        finish: brings a fresh policy into the state in which it acts.
    """

    sizes: dict[str, Any]
    larger: dict[str, Any]
    n_training_steps: int
    noise: "Callable[[Case, int, torch.Generator], dict[str, Tensor]]"
    finish: Callable[[PreTrainedPolicy], PreTrainedPolicy] = lambda policy: policy


KINDS: dict[str, Kind] = {}
"""By type; filled by `policy_cases` with those that are there."""


@dataclass(frozen=True)
class Case:
    """One policy: its type, inputs and settings."""

    name: str
    type: str
    inputs: dict[str, PolicyFeature]
    settings: dict[str, Any] = field(default_factory=dict)

    @property
    def kind(self) -> Kind:
        return KINDS[self.type]

    def config(self, **overrides: Any) -> PreTrainedConfig:
        settings = {
            "device": "cpu",
            "push_to_hub": False,
            **self.kind.sizes,
            **self.settings,
            **overrides,
        }
        actions = {"action": PolicyFeature(FeatureType.ACTION, (A,))}
        config_class = PreTrainedConfig.get_choice_class(self.type)
        return config_class(input_features=dict(self.inputs), output_features=actions, **settings)

    def policy(self, **overrides: Any) -> PreTrainedPolicy:
        torch.manual_seed(0)
        return self.kind.finish(get_policy_class(self.type)(self.config(**overrides)))

    def larger_policy(self) -> PreTrainedPolicy:
        return self.policy(**self.kind.larger)

    @property
    def n_training_steps(self) -> int:
        """Optimiser steps to learn eight samples by heart."""
        return self.kind.n_training_steps

    def noise(self, batch_size: int) -> dict[str, Tensor]:
        """What makes a policy that samples predict the same chunks whatever else is in the batch."""
        return self.kind.noise(self, batch_size, torch.Generator().manual_seed(6))

    def batch(self, batch_size: int = B) -> dict[str, Tensor]:
        generator = torch.Generator().manual_seed(1)
        batch = {
            key: torch.randn(batch_size, *feature.shape, generator=generator)
            for key, feature in self.inputs.items()
        }
        batch["action"] = torch.randn(batch_size, T, A, generator=generator)
        batch["action_is_pad"] = (
            torch.arange(T) >= torch.tensor([T, 2, 4])[torch.arange(batch_size) % 3, None]
        )
        return batch


def history_batch(policy: PreTrainedPolicy, batch_size: int = B) -> dict[str, Tensor]:
    """A batch with a time axis, and as many actions as the policy asks for; nothing is padded."""
    config, generator = policy.config, torch.Generator().manual_seed(4)
    batch = {
        key: torch.randn(batch_size, config.n_obs_steps, *feature.shape, generator=generator)
        for key, feature in config.input_features.items()
    }
    n_actions = len(config.action_delta_indices)
    batch["action"] = torch.randn(batch_size, n_actions, A, generator=generator)
    batch["action_is_pad"] = torch.zeros(batch_size, n_actions, dtype=torch.bool)
    if getattr(policy, "instruction_encoder", None) is not None:
        batch["observation.language.tokens"] = torch.tensor([[2, 5, 3]] * batch_size)
        batch["observation.language.attention_mask"] = torch.ones(batch_size, 3, dtype=torch.bool)
    return batch
