"""What each preset of `ActChunkedConfig` stands for."""

from typing import Any

from lerobot.configs import NormalizationMode

from lerobot_act_chunking.errors import unknown_choice

PRESETS = ("base", "paper")


def preset_values(preset: str, *, dim_model: int | None, pretrained: bool) -> dict[str, Any]:
    """Values of every field that a preset decides.

    Args:
        preset: ``paper`` for LeRobot's ACT defaults, which are the original code's; ``base`` for ours.
        dim_model: token width if it was set, for values that scale with it.
        pretrained: whether pretrained backbone weights were asked for.

    Raises:
        ConfigurationError: for an unknown preset.
    """
    if preset not in PRESETS:
        raise unknown_choice("preset", preset, PRESETS)
    if preset == "paper":
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
            "optimizer_betas": (0.9, 0.999),
            "lr_schedule": "constant",
            "lr_warmup_steps": 0,
        }
    return {
        "normalization_mapping": _mean_std("VISUAL", "STATE", "ENV", "ACTION"),
        "norm_std_floor": 1e-2,
        "execution": "crossfade",
        "backbone_norm": "frozen_batch" if pretrained else "group",
        "pre_norm": True,
        "dim_model": 512,
        "dim_feedforward": 4 * (dim_model or 512),
        "feedforward_activation": "gelu",
        "use_vae": False,
        "optimizer_lr": 1e-4,
        "optimizer_betas": (0.9, 0.95),
        "lr_schedule": "cosine",
        "lr_warmup_steps": 500,
    }


def _mean_std(*feature_types: str) -> dict[str, NormalizationMode]:
    return dict.fromkeys(feature_types, NormalizationMode.MEAN_STD)
