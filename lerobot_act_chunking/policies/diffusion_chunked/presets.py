"""What each preset of `DiffusionChunkedConfig` stands for, and what follows from its objective."""

from typing import Any

from lerobot.configs import NormalizationMode

from lerobot_act_chunking.errors import unknown_choice

PRESETS = ("base", "paper")

_BY_OBJECTIVE: dict[str, dict[str, Any]] = {
    "flow": {"prediction_type": "sample", "sampler": "euler", "num_inference_steps": 5},
    "ddpm": {"prediction_type": "epsilon", "sampler": "ddim", "num_inference_steps": 10},
    "two_step": {"prediction_type": "sample", "sampler": "two_step", "num_inference_steps": 2},
}


def preset_values(preset: str, *, objective: str | None, pretrained: bool) -> dict[str, Any]:
    """Values of every field that is not given.

    Args:
        preset: ``paper`` for the defaults of LeRobot's `diffusion`; ``base`` for ours.
        objective: what is learnt, if it was given; sampling follows from it.
        pretrained: whether pretrained backbone weights were asked for.

    Raises:
        ConfigurationError: for an unknown preset or objective.
    """
    if preset not in PRESETS:
        raise unknown_choice("preset", preset, PRESETS)
    objective = objective or ("ddpm" if preset == "paper" else "flow")
    if objective not in _BY_OBJECTIVE:
        raise unknown_choice("objective", objective, tuple(_BY_OBJECTIVE))
    values = {"objective": objective, **_BY_OBJECTIVE[objective]}
    return values | (_paper(objective) if preset == "paper" else _base(objective, pretrained))


def _base(objective: str, pretrained: bool) -> dict[str, Any]:
    # Noise prediction says nothing about the actions at full noise: without a range to clip to, it explodes.
    actions = NormalizationMode.MIN_MAX if objective == "ddpm" else NormalizationMode.MEAN_STD
    return {
        "denoiser": "mixer",
        "horizon": 100,
        "chunk_stride": 1,
        "align": "current",
        "execution": "crossfade",
        "normalization_mapping": {**_mean_std("VISUAL", "STATE", "ENV"), "ACTION": actions},
        "norm_std_floor": 1e-2,
        "clip_sample": objective == "ddpm",
        "clip_mode": "consistent",
        "do_mask_loss_for_padding": True,
        "unet_size": "S",
        "backbone_norm": "frozen_batch" if pretrained else "group",
        "use_ema": True,
        "optimizer_lr": 1e-3,
        "optimizer_betas": (0.9, 0.95),
        "lr_schedule": "cosine",
        "lr_warmup_steps": 200,
    }


def _paper(objective: str) -> dict[str, Any]:
    sampling = {"sampler": "ddpm", "num_inference_steps": 100} if objective == "ddpm" else {}
    min_max = dict.fromkeys(("STATE", "ACTION"), NormalizationMode.MIN_MAX)
    return sampling | {
        "denoiser": "unet1d",
        "n_obs_steps": 2,
        "horizon": 64,
        "n_action_steps": 32,
        "chunk_stride": 1,
        "align": "first_obs",
        "execution": "open_loop",
        "normalization_mapping": {**_mean_std("VISUAL"), **min_max},
        "norm_std_floor": 0.0,
        "clip_sample": True,
        "clip_mode": "lerobot" if objective == "ddpm" else "consistent",
        "do_mask_loss_for_padding": False,
        "unet_size": "XL",
        "backbone_norm": "frozen_batch",
        "use_ema": False,
        "optimizer_lr": 1e-4,
        "optimizer_betas": (0.95, 0.999),
        "lr_schedule": "cosine",
        "lr_warmup_steps": 500,
    }


def _mean_std(*feature_types: str) -> dict[str, NormalizationMode]:
    return dict.fromkeys(feature_types, NormalizationMode.MEAN_STD)
