"""What each preset of `ActChunkedConfig` stands for."""

from typing import TYPE_CHECKING, Any

from lerobot.configs import NormalizationMode

from lerobot_act_chunking.errors import unknown_choice

if TYPE_CHECKING:
    from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig

PRESETS = ("base", "paper", "autoregressive")
FORMER_NAMES = {"lecture": "autoregressive"}
"""Presets of earlier checkpoints, by the names that they have there."""


def preset_values(config: "ActChunkedConfig") -> dict[str, Any]:
    """Values of every field that a preset decides.

    ``paper`` are LeRobot's ACT defaults, which are the original code's; ``base`` are ours; ``autoregressive``
    has observation history, velocities, an autoregressive decoder and a sampled latent.

    Args:
        config: some values follow from fields that are given: widths, and how long a chunk is.

    Raises:
        ConfigurationError: for an unknown preset.
    """
    if config.preset not in PRESETS:
        raise unknown_choice("preset", config.preset, PRESETS)
    of_preset = {"base": _base, "paper": _paper, "autoregressive": _autoregressive}[config.preset]
    return _follow_given(config, {**_COMMON, **of_preset()})


def _follow_given(config: "ActChunkedConfig", values: dict[str, Any]) -> dict[str, Any]:
    """Values that fit to those that are given."""
    if config.encoder_impl != "act":
        values |= _MINILM
    if config.preset != "paper":
        values["backbone_norm"] = "frozen_batch" if config.starts_pretrained else "group"
        values["dim_feedforward"] = 4 * (config.dim_model or values["dim_model"])
        chunk_size = config.chunk_size or values["chunk_size"]
        actions_per_query = values["actions_per_query"] // (config.chunk_stride or 1)
        values["actions_per_query"] = _largest_divisor(chunk_size, max(1, actions_per_query))
    if config.bounded:
        values["normalization_mapping"]["ACTION"] = NormalizationMode.MIN_MAX
    return values


def _largest_divisor(count: int, at_most: int) -> int:
    return max(n for n in range(1, at_most + 1) if count % n == 0)


_MINILM = {"dim_model": 384, "n_heads": 12, "dim_feedforward": 1536, "n_encoder_layers": 6}

_COMMON = {
    "n_obs_steps": 1,
    "obs_stride": 1,
    "history_dropout": 0.0,
    "use_velocity": False,
    "chunk_size": 100,
    "actions_per_query": 1,
    "decoder_type": "parallel",
    "n_heads": 8,
    "n_decoder_layers": 1,
    "n_encoder_layers": 4,
    "n_vae_encoder_layers": 4,
    "dropout": 0.1,
    "latent_dim": 32,
    "z_inference": "mode",
    "style_observations": "state",
    "vae_action_stride": 1,
    "kl_weight": 10.0,
    "free_bits": 0.0,
    "norm_std_floor": 1e-2,
    "optimizer_lr": 1e-4,
    "optimizer_betas": (0.9, 0.95),
    "lr_schedule": "cosine",
    "lr_warmup_steps": 500,
}


def _paper() -> dict[str, Any]:
    return {
        "normalization_mapping": _mean_std("VISUAL", "STATE", "ACTION"),
        "norm_std_floor": 0.0,
        "execution": "open_loop",
        "backbone_norm": "frozen_batch",
        "pre_norm": False,
        "dim_model": 512,
        "dim_feedforward": 3200,
        "feedforward_activation": "relu",
        "use_vae": True,
        "optimizer_lr": 1e-5,
        "optimizer_lr_backbone": 1e-5,
        "optimizer_betas": (0.9, 0.999),
        "lr_schedule": "constant",
        "lr_warmup_steps": 0,
    }


def _base() -> dict[str, Any]:
    return {
        "normalization_mapping": _mean_std("VISUAL", "STATE", "ENV", "ACTION"),
        "execution": "crossfade",
        "actions_per_query": 10,
        "pre_norm": True,
        "dim_model": 256,
        "dropout": 0.0,
        "feedforward_activation": "gelu",
        "use_vae": False,
        "optimizer_lr": 5e-4,
        "lr_warmup_steps": 200,
    }


def _autoregressive() -> dict[str, Any]:
    return {
        **_base(),
        "n_obs_steps": 2,
        "obs_stride": 5,
        "history_dropout": 0.3,
        "use_velocity": True,
        "chunk_size": 50,
        "actions_per_query": 5,
        "execution": "ensemble",
        "decoder_type": "autoregressive",
        "n_decoder_layers": 4,
        "dim_model": 256,
        "use_vae": True,
        "latent_dim": 16,
        "z_inference": "sample",
        "style_observations": "all",
        "vae_action_stride": 5,
        "kl_weight": 0.01,
        "free_bits": 0.05,
    }


def _mean_std(*feature_types: str) -> dict[str, NormalizationMode]:
    return dict.fromkeys(feature_types, NormalizationMode.MEAN_STD)
