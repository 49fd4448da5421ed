"""Random configurations: sensible, unusual and hostile values for every field, over random features."""

import random
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin

from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig
from policy_cases import MODULES, TYPES

from act_chunking_runtime.settings import Kernel, Mode, Weighting
from lerobot_act_chunking.policies.choices import choices_of
from lerobot_act_chunking.policies.field_checks import own_fields
from lerobot_act_chunking.ranges import RANGES

HOSTILE = (0, -1, 10**7, 10**12, 2**70, 0.5, -0.5, 1e300, float("nan"), float("inf"), -float("inf"))
HOSTILE += (None, "", "other", True, [], [0], [10**7], (1, 2, 3), {}, {"a": 1})  # of other kinds
SMALL_CNN = {"vision_backbone": "small_cnn"}
# What keeps networks tiny; drawn values and presets come on top.
TINY = {name: MODULES[name].TINY for name in TYPES}
# Values near which most fields are drawn. Widths and layers stay tiny: a fuzz is about combinations.
WIDTHS = (4, 8, 12, 16, 20)
NEAR: dict[str, tuple[Any, ...]] = {
    **dict.fromkeys(
        ("dim_model", "gpt_hidden_dim", "dim_feedforward", "latent_dim", "vqvae_embedding_dim"), WIDTHS
    ),
    **dict.fromkeys(
        ("vqvae_enc_hidden_dim", "diffusion_step_embed_dim", "n_bins", "vqvae_n_embed"), (*WIDTHS, 5)
    ),
    **dict.fromkeys(("n_heads", "gpt_n_head", "n_groups"), (1, 2, 4)),
    **dict.fromkeys(("chunk_size", "horizon"), (1, 2, 4, 6, 7, 8)),
    **dict.fromkeys(
        ("optimizer_lr", "optimizer_lr_backbone", "optimizer_lr_encoder", "optimizer_vqvae_lr"),
        (0.0, 1e-4, 1e-2, 1.0),
    ),
    "noise_seed": (0, 5, 2**63 - 1),
    "n_action_steps": (1, 2, 3, 6),
    "fps": (10, 30.0, 50),
    "horizon_s": (0.05, 0.1, 0.2),
    "prediction_dt": (0.02, 0.04, 0.1),
    "replan_s": (0.02, 0.1),
    "preset": ("base", "paper", "autoregressive"),
    "vision_backbone": ("small_cnn", "small_cnn", "timm:none", "timm:"),
    "pretrained_backbone_weights": ("imagenet", "none.safetensors", "ResNet18_Weights.IMAGENET1K_V1"),
    "tokenizer_path": ("none",),
    "language_encoder": (None,),  # loads a package
    "language_dropout": (0.0, 0.0, 0.5),  # refused without an encoder
    "state_keys": ([], ["observation.state"], ["observation.environment_state"], ["observation.none"]),
    "guidance_features": ([], ["observation.state"], ["observation.none"]),
    "gripper_dims": ([], [0], [1], [0, 1], [0, 0], [5], (0,)),
    "down_dims": ((8,), (4, 8), (4, 4, 8), ()),
    "head_hidden_dims": ((), (5,), (6, 4)),
    "fsq_levels": ((2,), (2, 3), (4, 4), ()),
    "optimizer_betas": ((0.9, 0.95), (0.0, 0.0), (0.9, 1.0), (0.9,)),
    "normalization_mapping": (*({"ACTION": mode} for mode in NormalizationMode), {"STATE": "MIN_MAX"}),
    "execution": get_args(Mode),
    "ensemble_weighting": get_args(Weighting),
    "adaptive_kernel": get_args(Kernel),
    "compile_model": (False,),  # takes a minute
    "balance_modes": ("none",),  # the others need a dataset
    "inner_path": ("none",),
    "encoder_weights": ("none",),
    "instructions": (None,),  # filled in by training
    "encoder_vocabulary": (0,),  # with more, batches need instructions
}
STATE = {"observation.state": PolicyFeature(FeatureType.STATE, (2,))}
IMAGES = {"observation.images.top": PolicyFeature(FeatureType.VISUAL, (3, 16, 24))}


@dataclass(frozen=True)
class Draw:
    """One random configuration of a policy type, not yet made."""

    type: str
    settings: dict[str, Any]
    inputs: dict[str, PolicyFeature]
    action_dim: int

    def config(self) -> PreTrainedConfig:
        config_class = PreTrainedConfig.get_choice_class(self.type)
        action = PolicyFeature(FeatureType.ACTION, (self.action_dim,))
        return config_class(
            device="cpu",
            push_to_hub=False,
            input_features=dict(self.inputs),
            output_features={"action": action},
            **self.settings,
        )


def named(policy_type: str, inputs: dict[str, PolicyFeature] = STATE, **settings: Any) -> Draw:
    """A tiny configuration with these settings."""
    return Draw(policy_type, SMALL_CNN | TINY[policy_type] | settings, inputs, action_dim=2)


def draw(policy_type: str, seed: int) -> Draw:
    """The configuration of this seed: a tiny one with some fields changed, some to hostile values."""
    rng = random.Random(f"{policy_type} {seed}")
    config_class: Any = PreTrainedConfig.get_choice_class(policy_type)
    settings = SMALL_CNN | TINY[policy_type]
    for name, hint, _ in rng.sample(own_fields(config_class), rng.choice((1, 2, 3, 5, 8))):
        settings[name] = _value(name, hint, choices_of(config_class), rng)
    if rng.random() < 0.3:
        settings[rng.choice(list(settings))] = rng.choice(HOSTILE)
    hints = {name: hint for name, hint, _ in own_fields(config_class)}
    settings = {name: _as_typed(value, hints[name]) for name, value in settings.items()}
    return Draw(policy_type, settings, _inputs(rng), rng.choice((1, 2, 3)))


def _as_typed(value: Any, hint: Any) -> Any:
    """The value as a command line or a file would make it: 1.0 for 1, a tuple for a list."""
    if hint is float and type(value) is int:
        return float(value)
    kind = get_origin(hint)
    return kind(value) if kind in (list, tuple) and isinstance(value, list | tuple) else value


def _value(name: str, hint: Any, choices: Mapping[str, tuple[str, ...]], rng: random.Random) -> Any:
    if name in NEAR or name in choices:
        return rng.choice(NEAR.get(name) or choices[name])
    if get_origin(hint) is Literal:
        return rng.choice(get_args(hint))
    if hint is bool:
        return rng.random() < 0.5
    if name in RANGES:
        allowed = RANGES[name]
        near = [allowed.least, allowed.least + 1, allowed.least + 2, 3, 1]
        if hint is float:  # whole numbers are sizes, too costly near their limit
            near += [(allowed.least + 1) / 2, 0.25, 1e-6, allowed.most, allowed.most * 0.99]
        return rng.choice([int(value) for value in near] if hint is int else near)
    return rng.choice(HOSTILE)


def _inputs(rng: random.Random) -> dict[str, PolicyFeature]:
    candidates = {
        "observation.state": PolicyFeature(FeatureType.STATE, (rng.choice((1, 2, 5)),)),
        "observation.gripper": PolicyFeature(FeatureType.STATE, (1,)),
        "observation.environment_state": PolicyFeature(FeatureType.ENV, (rng.choice((1, 4)),)),
        "observation.images.top": PolicyFeature(FeatureType.VISUAL, (3, 16, 24)),
        "observation.images.wrist": PolicyFeature(FeatureType.VISUAL, (3, 17, 16)),
    }
    kept = rng.sample(sorted(candidates), rng.choice((1, 1, 2, 3)))
    return {key: candidates[key] for key in kept}
