"""Small policies of every type and kind of input; a new policy adds its cases and inherits the contract."""

from dataclasses import dataclass, field, fields
from typing import Any

import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.policies.factory import get_policy_class
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor

import lerobot_act_chunking.policies.act_chunked.configuration_act_chunked  # noqa: F401  (registers the type)
from lerobot_act_chunking.policies.execution_fields import ExecutionFields
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)

B, T, A = 3, 5, 4
STATE = {"observation.state": PolicyFeature(FeatureType.STATE, (6,))}
VELOCITY = {"observation.velocity": PolicyFeature(FeatureType.STATE, (2,))}
ENVIRONMENT = {"observation.environment_state": PolicyFeature(FeatureType.ENV, (7,))}
TOP = {"observation.images.top": PolicyFeature(FeatureType.VISUAL, (3, 32, 48))}
WRIST = {"observation.images.wrist": PolicyFeature(FeatureType.VISUAL, (3, 32, 32))}
SIZES = {
    "dim_model": 16,
    "n_heads": 2,
    "dim_feedforward": 24,
    "n_encoder_layers": 2,
    "n_vae_encoder_layers": 2,
    "latent_dim": 8,
    "dropout": 0.0,
    "vision_backbone": "small_cnn",
}


@dataclass(frozen=True)
class Case:
    """One policy: its type, inputs and settings."""

    name: str
    type: str
    inputs: dict[str, PolicyFeature]
    settings: dict[str, Any] = field(default_factory=dict)

    def config(self, **overrides: Any) -> PreTrainedConfig:
        settings = {
            "device": "cpu",
            "push_to_hub": False,
            "chunk_size": T,
            **SIZES,
            **self.settings,
            **overrides,
        }
        actions = {"action": PolicyFeature(FeatureType.ACTION, (A,))}
        config_class = PreTrainedConfig.get_choice_class(self.type)
        return config_class(input_features=dict(self.inputs), output_features=actions, **settings)

    def policy(self, **overrides: Any) -> PreTrainedPolicy:
        torch.manual_seed(0)
        return get_policy_class(self.type)(self.config(**overrides))

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


@dataclass(frozen=True)
class WrappedCase(Case):
    """The same policy as the inner one of a `temporal_ensemble`."""

    def config(self, **overrides: Any) -> PreTrainedConfig:
        own = {each.name for each in fields(ExecutionFields)} | {"n_action_steps"}
        execution = {name: overrides.pop(name) for name in own & overrides.keys()}
        return TemporalEnsembleConfig(
            inner={"type": "act_chunked", "chunk_size": T, **SIZES, **self.settings, **overrides},
            input_features=dict(self.inputs),
            output_features={"action": PolicyFeature(FeatureType.ACTION, (A,))},
            device="cpu",
            push_to_hub=False,
            **execution,
        )


CASES = [
    Case("state", "act_chunked", STATE),
    Case("environment", "act_chunked", ENVIRONMENT, {"n_decoder_layers": 2, "use_ema": True}),
    Case("vectors", "act_chunked", STATE | VELOCITY | ENVIRONMENT, {"actions_per_query": 5, "use_vae": True}),
    Case("cameras", "act_chunked", TOP | WRIST, {"use_vae": True}),
    Case("mixed", "act_chunked", STATE | TOP, {"preset": "paper"}),
]
WRAPPED = WrappedCase("vectors", "temporal_ensemble", STATE | VELOCITY | ENVIRONMENT, {"use_ema": True})
