"""Small inner policies of every type that can be built here, and batches for them."""

from dataclasses import dataclass
from typing import Any

import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from policy_cases import LENGTHS, MODULES, SIZES, TYPES
from torch import Tensor

from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)
from lerobot_act_chunking.policies.temporal_ensemble.modeling_temporal_ensemble import TemporalEnsemblePolicy

B, A = 3, 4
STATE = {"observation.state": PolicyFeature(FeatureType.STATE, (6,))}
ENVIRONMENT = {"observation.environment_state": PolicyFeature(FeatureType.ENV, (7,))}
CAMERA = {"observation.images.top": PolicyFeature(FeatureType.VISUAL, (3, 32, 32))}
ACTIONS = {"action": PolicyFeature(FeatureType.ACTION, (A,))}

SMALL = {"dim_model": 16, "n_heads": 2, "dim_feedforward": 24, "n_encoder_layers": 1, "dropout": 0.0}


@dataclass(frozen=True)
class Case:
    """An inner policy: its type, inputs, settings, longest chunk, and how much of it it executes itself."""

    type: str
    inputs: dict[str, PolicyFeature]
    settings: dict[str, Any]
    chunk_size: int
    executes: int

    @property
    def inner(self) -> dict[str, Any]:
        return {"type": self.type, **self.settings}

    def bare(self, **overrides: Any):
        """The policy itself, from weights that depend on nothing."""
        config = PreTrainedConfig.get_choice_class(self.type)(
            input_features=dict(self.inputs),
            output_features=dict(ACTIONS),
            device="cpu",
            push_to_hub=False,
            **{**self.settings, **overrides},
        )
        with torch.random.fork_rng():
            torch.manual_seed(0)
            policy = get_policy_class(self.type)(config).eval()
        if self.type == "vqbet":  # as after its first phase of training
            policy.vqbet.action_head.vqvae_model.discretized.fill_(True)
        return policy

    def config(self, **execution: Any) -> TemporalEnsembleConfig:
        return TemporalEnsembleConfig(
            inner=self.inner,
            input_features=dict(self.inputs),
            output_features=dict(ACTIONS),
            device="cpu",
            push_to_hub=False,
            **execution,
        )

    def wrapped(self, **execution: Any) -> TemporalEnsemblePolicy:
        """The wrapper, over the same weights as `bare`."""
        with torch.random.fork_rng():
            policy = TemporalEnsemblePolicy(self.config(**execution)).eval()
        policy.inner.load_state_dict(self.bare().state_dict())
        return policy

    def batch(self, seed: int = 1, batch_size: int = B) -> dict[str, Tensor]:
        generator = torch.Generator().manual_seed(seed)
        return {
            key: torch.empty(batch_size, *feature.shape).normal_(generator=generator)
            for key, feature in self.inputs.items()
        }

    def training_batch(self) -> dict[str, Tensor]:
        """With the time axes that LeRobot's dataset gives this type."""
        config = self.config()
        batch, n_actions = self.batch(), len(config.action_delta_indices)
        if config.observation_delta_indices is not None:
            steps = len(config.observation_delta_indices)
            batch = {key: torch.stack([value] * steps, dim=1) for key, value in batch.items()}
        generator = torch.Generator().manual_seed(2)
        batch["action"] = torch.empty(B, n_actions, A).normal_(generator=generator)
        batch["action_is_pad"] = torch.zeros(B, n_actions, dtype=torch.bool)
        return batch

    def checkpoint(self, folder, **overrides: Any):
        """A saved bare policy with its processors; returns the folder."""
        policy = self.bare(**overrides)
        policy.save_pretrained(folder)
        statistics = {
            key: {
                "mean": torch.full(shape, 0.3),
                "std": torch.full(shape, 0.7),
                "min": torch.full(shape, -2.0),
                "max": torch.full(shape, 3.0),
            }
            for key, shape in (
                (key, (3, 1, 1) if feature.type is FeatureType.VISUAL else feature.shape)
                for key, feature in {**self.inputs, **ACTIONS}.items()
            )
        }
        for pipeline in make_pre_post_processors(policy.config, dataset_stats=statistics):
            pipeline.save_pretrained(folder)
        return folder


ACT = Case(
    "act",
    STATE | ENVIRONMENT,
    {**SMALL, "chunk_size": 9, "n_action_steps": 5, "n_vae_encoder_layers": 1, "latent_dim": 8},
    chunk_size=9,
    executes=5,
)
_FIRST = TYPES[0]
OURS = Case(
    _FIRST,
    STATE | ENVIRONMENT,
    {
        **SIZES[_FIRST],
        **MODULES[_FIRST].DETERMINISTIC,
        LENGTHS[_FIRST]: 4,
        "chunk_stride": 3,
        "n_action_steps": 5,
        "execution": "open_loop",
    },
    chunk_size=10,
    executes=5,
)
DIFFUSION = Case(
    "diffusion",
    STATE | ENVIRONMENT,
    {
        "n_obs_steps": 2,
        "horizon": 8,
        "n_action_steps": 3,
        "down_dims": [8, 16],
        "n_groups": 4,
        "diffusion_step_embed_dim": 8,
        "num_train_timesteps": 3,
    },
    chunk_size=7,
    executes=3,
)
DIFFUSION_CAMERA = Case(
    "diffusion",
    STATE | CAMERA,
    {
        **DIFFUSION.settings,
        "pretrained_backbone_weights": None,
        "use_group_norm": True,
        "spatial_softmax_num_keypoints": 4,
    },
    chunk_size=7,
    executes=3,
)
FLOW = Case(
    "diffusion_chunked",
    STATE | ENVIRONMENT,
    {
        "n_obs_steps": 2,
        "horizon": 4,
        "chunk_stride": 3,
        "n_action_steps": 5,
        "execution": "open_loop",
        "prediction_type": "velocity",
        "dim_model": 16,
        "n_layers": 1,
    },
    chunk_size=10,
    executes=5,
)
CODES = Case(
    "vqbet_chunked",
    STATE | ENVIRONMENT,
    {
        "n_obs_steps": 2,
        "chunk_size": 4,
        "chunk_stride": 3,
        "n_action_steps": 5,
        "execution": "open_loop",
        "tokenizer": "fsq",
        "gpt_hidden_dim": 16,
        "gpt_n_layer": 1,
    },
    chunk_size=10,
    executes=5,
)
VQBET = Case(
    "vqbet",
    STATE | CAMERA,
    {
        "n_obs_steps": 3,
        "n_action_pred_token": 2,
        "action_chunk_size": 5,
        "crop_shape": None,
        "pretrained_backbone_weights": None,
        "use_group_norm": True,
        "spatial_softmax_num_keypoints": 4,
        "vqvae_n_embed": 4,
        "vqvae_embedding_dim": 8,
        "vqvae_enc_hidden_dim": 8,
        "gpt_block_size": 60,
        "gpt_input_dim": 16,
        "gpt_output_dim": 16,
        "gpt_hidden_dim": 16,
        "gpt_n_layer": 1,
        "gpt_n_head": 2,
        "dropout": 0.0,
    },
    chunk_size=5,
    executes=5,
)
CASES = {
    "act": ACT,
    "ours": OURS,
    "diffusion": DIFFUSION,
    "camera": DIFFUSION_CAMERA,
    "vqbet": VQBET,
    **{name: case for name, case in (("flow", FLOW), ("codes", CODES)) if case.type in TYPES},
}
