"""Checkpoints of LeRobot's policies and of ours to evaluate in `aloha_sim`, and how many steps of it."""

from pathlib import Path

import torch
from lerobot.configs import FeatureType, PreTrainedConfig
from lerobot.envs.utils import env_to_policy_features
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from policy_cases import MODULES, TYPES

from lerobot_act_chunking.envs.configuration_envs import AlohaSimEnvConfig

TRANSFORMER = {"dim_model": 16, "n_heads": 2, "dim_feedforward": 24, "n_encoder_layers": 1, "use_vae": False}
INNER = {
    "act": {**TRANSFORMER, "chunk_size": 12, "n_action_steps": 12},
    "diffusion": {
        "horizon": 16,
        "n_action_steps": 8,
        "down_dims": (8, 16),
        "n_groups": 4,
        "diffusion_step_embed_dim": 8,
        "num_train_timesteps": 5,
    },
}
INNER |= {name: module.SHORT for name, module in MODULES.items() if name in TYPES}
STEPS, EPISODES = 20, 2


def checkpoint(policy_type: str, folder: Path) -> Path:
    """A policy for `aloha_sim` that has learned nothing, with its processors."""
    features = env_to_policy_features(AlohaSimEnvConfig(obs_type="state"))
    actions = {key: feature for key, feature in features.items() if feature.type is FeatureType.ACTION}
    config = PreTrainedConfig.get_choice_class(policy_type)(
        input_features={key: feature for key, feature in features.items() if key not in actions},
        output_features=actions,
        device="cpu",
        push_to_hub=False,
        **INNER[policy_type],
    )
    statistics = {
        key: {
            name: torch.full(feature.shape, value)
            for name, value in {"mean": 0.1, "std": 0.3, "min": -1.0, "max": 1.0}.items()
        }
        for key, feature in features.items()
    }
    torch.manual_seed(0)
    policy = get_policy_class(policy_type)(config)
    for part in (policy, *make_pre_post_processors(config, dataset_stats=statistics)):
        part.save_pretrained(folder)
    return folder
