"""What each preset of `VqbetChunkedConfig` stands for."""

from typing import Any

from lerobot.configs import NormalizationMode

from lerobot_act_chunking.errors import look_up, unknown_choice
from lerobot_act_chunking.tokenizers.make import TOKENIZERS

PRESETS = ("base", "paper")


def preset_values(preset: str, *, tokenizer: str | None, pretrained: bool) -> dict[str, Any]:
    """Values of every field that is not given.

    Args:
        preset: ``paper`` for the defaults of LeRobot's `vqbet`; ``base`` for ours.
        tokenizer: if it was given; the normalisation of actions follows from it.
        pretrained: whether pretrained backbone weights were asked for.

    Raises:
        ConfigurationError: for an unknown preset or tokenizer.
    """
    if preset not in PRESETS:
        raise unknown_choice("preset", preset, PRESETS)
    tokenizer = tokenizer or "residual_vq"
    bounded = look_up("tokenizer", tokenizer, TOKENIZERS).is_bounded
    return {"tokenizer": tokenizer} | (_paper() if preset == "paper" else _base(bounded, pretrained))


def _base(bounded: bool, pretrained: bool) -> dict[str, Any]:
    actions = NormalizationMode.MIN_MAX if bounded else NormalizationMode.MEAN_STD
    mean_std = dict.fromkeys(("VISUAL", "STATE", "ENV"), NormalizationMode.MEAN_STD)
    return {
        "n_obs_steps": 1,
        "n_action_pred_token": 1,
        "chunk_size": 100,
        "chunk_stride": 1,
        "execution": "crossfade",
        "normalization_mapping": {**mean_std, "ACTION": actions},
        "norm_std_floor": 1e-2,
        "backbone_norm": "frozen_batch" if pretrained else "group",
        "vqvae_n_embed": 16,
        "vqvae_num_layers": 2,
        "vqvae_embedding_dim": 64,
        "vqvae_enc_hidden_dim": 256,
        "vqvae_coder": "mlp",
        "vqvae_decay": 0.99,
        "commitment_weight": 0.25,
        "kmeans_iters": 20,
        "dead_code_threshold": 0.25,
        "rotation_trick": True,
        "fsq_levels": (2, 2, 2, 2),
        "n_bins": 65,
        "dct_coefficients": 5,
        "n_vqvae_training_steps": 500,
        "gpt_hidden_dim": 256,
        "gpt_n_layer": 4,
        "gpt_n_head": 8,
        "dropout": 0.0,
        "head_hidden_dims": (512, 512),
        "sequentially_select": True,
        "focal_gamma": 0.0,
        "offset_mode": "code_conditioned",
        "offset_target": "gt_code",
        "offset_loss_weight": 100.0,
        "bet_softmax_temperature": 1.0,
        "top_p": 0.95,
        "use_ema": True,
        "optimizer_lr": 5e-4,
        "optimizer_betas": (0.9, 0.95),
        "optimizer_weight_decay": 1e-4,
        "lr_schedule": "cosine",
        "lr_warmup_steps": 200,
    }


def _paper() -> dict[str, Any]:
    min_max = dict.fromkeys(("STATE", "ENV", "ACTION"), NormalizationMode.MIN_MAX)
    return {
        "n_obs_steps": 5,
        "n_action_pred_token": 3,
        "chunk_size": 5,
        "chunk_stride": 1,
        "execution": "open_loop",
        "normalization_mapping": {"VISUAL": NormalizationMode.IDENTITY, **min_max},
        "norm_std_floor": 0.0,
        "backbone_norm": "frozen_batch",
        "vqvae_n_embed": 16,
        "vqvae_num_layers": 2,
        "vqvae_embedding_dim": 256,
        "vqvae_enc_hidden_dim": 128,
        "vqvae_coder": "mlp",
        "vqvae_decay": 0.8,
        "commitment_weight": 1.0,
        "kmeans_iters": 0,
        "dead_code_threshold": 0.0,
        "rotation_trick": False,
        "fsq_levels": (2, 2, 2, 2),
        "n_bins": 256,
        "dct_coefficients": 5,
        "n_vqvae_training_steps": 20_000,
        "gpt_hidden_dim": 512,
        "gpt_n_layer": 8,
        "gpt_n_head": 8,
        "dropout": 0.1,
        "head_hidden_dims": (),
        "sequentially_select": False,
        "focal_gamma": 2.0,
        "offset_mode": "table",
        "offset_target": "sampled",
        "offset_loss_weight": 10_000.0,
        "bet_softmax_temperature": 0.1,
        "top_p": 1.0,
        "use_ema": False,
        "optimizer_lr": 1e-4,
        "optimizer_betas": (0.95, 0.999),
        "optimizer_weight_decay": 1e-6,
        "lr_schedule": "cosine",
        "lr_warmup_steps": 500,
    }
