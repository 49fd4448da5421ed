"""Small policies of every type and kind of input; a new policy adds its cases and inherits the contract."""

from dataclasses import dataclass, field, fields
from typing import Any

import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.policies.factory import get_policy_class
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor

import lerobot_act_chunking.policies.act_chunked.configuration_act_chunked
import lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked
import lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked  # noqa: F401  (register)
from lerobot_act_chunking.policies.execution_fields import ExecutionFields
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)
from lerobot_act_chunking.tokenizers.make import make_tokenizer

B, T, A = 3, 5, 4
STATE = {"observation.state": PolicyFeature(FeatureType.STATE, (6,))}
VELOCITY = {"observation.velocity": PolicyFeature(FeatureType.STATE, (2,))}
ENVIRONMENT = {"observation.environment_state": PolicyFeature(FeatureType.ENV, (7,))}
TOP = {"observation.images.top": PolicyFeature(FeatureType.VISUAL, (3, 32, 48))}
WRIST = {"observation.images.wrist": PolicyFeature(FeatureType.VISUAL, (3, 32, 32))}
ACT = {
    "chunk_size": T,
    "dim_model": 16,
    "n_heads": 2,
    "dim_feedforward": 24,
    "n_encoder_layers": 2,
    "n_vae_encoder_layers": 2,
    "latent_dim": 8,
    "dropout": 0.0,
    "vision_backbone": "small_cnn",
}
DIFFUSION = {
    "horizon": T,
    "dim_model": 16,
    "n_layers": 2,
    "n_heads": 2,
    "down_dims": (8,),
    "n_groups": 4,
    "diffusion_step_embed_dim": 8,
    "spatial_softmax_num_keypoints": 3,
    "vision_backbone": "small_cnn",
}
VQBET = {
    "chunk_size": T,
    "gpt_hidden_dim": 16,
    "gpt_n_layer": 2,
    "gpt_n_head": 2,
    "head_hidden_dims": (24,),
    "vqvae_n_embed": 6,
    "vqvae_embedding_dim": 8,
    "vqvae_enc_hidden_dim": 12,
    "n_bins": 9,
    "dct_coefficients": 3,
    "fsq_levels": (3, 3),
    "n_vqvae_training_steps": 1,
    "kmeans_iters": 2,
    "spatial_softmax_num_keypoints": 3,
    "vision_backbone": "small_cnn",
}
SIZES = {"act_chunked": ACT, "diffusion_chunked": DIFFUSION, "vqbet_chunked": VQBET}
# Enough to learn eight samples by heart, without what would make their loss noisy.
LARGER = {
    "act_chunked": {"dim_model": 32, "dim_feedforward": 64, "use_vae": False},
    "diffusion_chunked": {
        "dim_model": 48,
        "down_dims": (48,),
        "condition_dropout": 0.0,
        "guidance_scale": 1.0,
    },
    "vqbet_chunked": {"gpt_hidden_dim": 32, "bet_softmax_temperature": 0.0},
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
            **SIZES[self.type],
            **self.settings,
            **overrides,
        }
        actions = {"action": PolicyFeature(FeatureType.ACTION, (A,))}
        config_class = PreTrainedConfig.get_choice_class(self.type)
        return config_class(input_features=dict(self.inputs), output_features=actions, **settings)

    def policy(self, **overrides: Any) -> PreTrainedPolicy:
        torch.manual_seed(0)
        policy = get_policy_class(self.type)(self.config(**overrides))
        return self._with_tokenizer(policy) if self.type == "vqbet_chunked" else policy

    def _with_tokenizer(self, policy: PreTrainedPolicy) -> PreTrainedPolicy:
        """The policy behind the phase in which its tokenizer learns alone."""
        while policy.tokenizer_phase.comes_first:
            policy.train().forward(history_batch(policy))
        policy.eval().forward(history_batch(policy))
        return policy

    def larger_policy(self) -> PreTrainedPolicy:
        return self.policy(**LARGER[self.type])

    @property
    def n_training_steps(self) -> int:
        """Optimiser steps to learn eight samples by heart; generative policies have more to learn."""
        return 160 if self.type == "act_chunked" else 400

    def noise(self, batch_size: int) -> dict[str, Tensor]:
        """What makes a policy that samples predict the same chunks whatever else is in the batch."""
        generator = torch.Generator().manual_seed(6)
        if self.type == "diffusion_chunked":
            return {"noise": torch.randn(batch_size, T, A, generator=generator)}
        if self.type == "act_chunked" and self.config().is_stochastic:
            network = self.policy().model
            return {
                "noise": torch.randn(batch_size, network.latent.n_noise, generator=generator),
                "draws": torch.rand(batch_size, *network.head.draws_shape, generator=generator),
            }
        if self.type == "vqbet_chunked":
            n_codes = make_tokenizer(self.config().tokenizer_spec).n_codes
            return {"noise": torch.rand(batch_size, n_codes, generator=generator)}
        return {}

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
    """An `act_chunked` as the inner policy of a `temporal_ensemble`."""

    def larger_policy(self) -> PreTrainedPolicy:
        return self.policy(**LARGER["act_chunked"])

    def config(self, **overrides: Any) -> PreTrainedConfig:
        own = {each.name for each in fields(ExecutionFields)} | {"n_action_steps"}
        execution = {name: overrides.pop(name) for name in own & overrides.keys()}
        return TemporalEnsembleConfig(
            inner={"type": "act_chunked", **ACT, **self.settings, **overrides},
            input_features=dict(self.inputs),
            output_features={"action": PolicyFeature(FeatureType.ACTION, (A,))},
            device="cpu",
            push_to_hub=False,
            **execution,
        )


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
    return batch


DDPM = {"objective": "ddpm", "clip_sample_range": 4.0}  # the actions are not normalised
PAPER_AT_T = {"n_obs_steps": 1, "n_action_steps": T, "sampler": "ddim", "num_inference_steps": 20} | DDPM
GUIDED = {
    "guidance_features": ["observation.environment_state"],
    "condition_dropout": 0.5,
    "guidance_scale": 1.5,
}
TWO_LAYERS = {"n_decoder_layers": 2, "actions_per_query": 1, "use_ema": True}  # queries attend to each other
SAMPLED = {
    "use_vae": True,
    "latent_type": "conditional",
    "z_inference": "sample",
    "action_likelihood": "gaussian",
    "action_temperature": 1.0,
}
AUTOREGRESSIVE = {
    "image_tokens": "summary",
    "decoder_type": "autoregressive",
    "actions_per_query": 1,
    "n_decoder_layers": 2,
}
PARALLEL = {"sequentially_select": False, "use_ema": False}
LEROBOT_AT_T = {"n_obs_steps": 1, "n_action_pred_token": 1, "head_hidden_dims": (), "kmeans_iters": 0}

CASES = [
    Case("state", "act_chunked", STATE),
    Case("environment", "act_chunked", ENVIRONMENT, TWO_LAYERS),
    Case("vectors", "act_chunked", STATE | VELOCITY | ENVIRONMENT, {"actions_per_query": 5, "use_vae": True}),
    Case("cameras", "act_chunked", TOP | WRIST, {"use_vae": True}),
    Case("mixed", "act_chunked", STATE | TOP, {"preset": "paper"}),
    Case("sampled", "act_chunked", STATE | ENVIRONMENT, SAMPLED),
    Case("autoregressive", "act_chunked", STATE | TOP, AUTOREGRESSIVE),
    Case("state", "diffusion_chunked", STATE, {"actions_per_token": 1}),
    Case("velocity", "diffusion_chunked", STATE | ENVIRONMENT, {"prediction_type": "velocity"}),
    Case("two-step", "diffusion_chunked", STATE | VELOCITY, {"objective": "two_step"}),
    Case("dit", "diffusion_chunked", ENVIRONMENT | TOP, {"denoiser": "dit", "use_ema": False}),
    Case("unet", "diffusion_chunked", STATE | TOP | WRIST, {"denoiser": "unet1d"} | DDPM),
    Case("paper", "diffusion_chunked", STATE | ENVIRONMENT, {"preset": "paper"} | PAPER_AT_T),
    Case("goal", "diffusion_chunked", STATE | ENVIRONMENT, {"denoiser": "dit"} | GUIDED),
    Case("prefix", "diffusion_chunked", STATE, {"actions_per_token": 1, "prefix_steps": 2}),
    Case("state", "vqbet_chunked", STATE),
    Case("joint", "vqbet_chunked", STATE | VELOCITY, {"tokenizer_training": "joint", "use_ema": False}),
    Case("fsq", "vqbet_chunked", ENVIRONMENT | TOP, {"tokenizer": "fsq", "vqvae_coder": "conv"}),
    Case("uniform", "vqbet_chunked", STATE | TOP | WRIST, {"tokenizer": "uniform"}),
    Case("dct", "vqbet_chunked", STATE | VELOCITY | ENVIRONMENT, {"tokenizer": "dct"} | PARALLEL),
    Case("paper", "vqbet_chunked", STATE | TOP, {"preset": "paper"} | LEROBOT_AT_T),
    Case("sampled", "vqbet_chunked", STATE, {"offset_target": "sampled", "code_hold": "episode"}),
]
WRAPPED = WrappedCase("vectors", "temporal_ensemble", STATE | VELOCITY | ENVIRONMENT, {"use_ema": True})
