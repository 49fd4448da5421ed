"""Checkpoints of LeRobot's ``act`` as its versions have written them."""

import json

import torch
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors
from safetensors.torch import load_file, save_file

B, T, A, S, E = 3, 5, 4, 6, 7
STATE = {"observation.state": PolicyFeature(FeatureType.STATE, (S,))}
ENVIRONMENT = {"observation.environment_state": PolicyFeature(FeatureType.ENV, (E,))}
CAMERAS = {
    "observation.images.top": PolicyFeature(FeatureType.VISUAL, (3, 32, 64)),
    "observation.images.left_wrist": PolicyFeature(FeatureType.VISUAL, (3, 32, 64)),
}
ACTION = {"action": PolicyFeature(FeatureType.ACTION, (A,))}
INPUTS = {
    "state+environment": STATE | ENVIRONMENT,
    "environment": ENVIRONMENT,
    "state+cameras": STATE | CAMERAS,
    "cameras": CAMERAS,
    "all": STATE | ENVIRONMENT | CAMERAS,
}
SMALL = {
    "device": "cpu",
    "chunk_size": T,
    "n_action_steps": T,
    "dim_model": 16,
    "n_heads": 2,
    "dim_feedforward": 24,
    "latent_dim": 8,
    "n_encoder_layers": 2,
    "n_vae_encoder_layers": 2,
    "dropout": 0.0,
    "pretrained_backbone_weights": None,
}


def make_act(inputs, **settings):
    """A policy of LeRobot's whose parameters are all in effect: many start at zero."""
    torch.manual_seed(0)
    config = ACTConfig(input_features=dict(INPUTS[inputs]), output_features=ACTION, **{**SMALL, **settings})
    policy = ACTPolicy(config)
    for name, parameter in policy.named_parameters():
        if "backbone" not in name:
            parameter.data += 0.1 * torch.randn_like(parameter)
    return policy.eval()


def statistics(policy):
    """Unlike for every feature and dimension."""
    features = {**policy.config.input_features, **policy.config.output_features}
    generator = torch.Generator().manual_seed(1)
    stats = {}
    for key, feature in features.items():
        shape = (3, 1, 1) if feature.type is FeatureType.VISUAL else feature.shape
        low = torch.rand(shape, generator=generator)
        stats[key] = {"mean": low, "std": low + 0.5, "min": low - 1, "max": low + 2}
    return stats


def save(policy, folder):
    """The checkpoint that LeRobot writes now."""
    for part in (policy, *make_pre_post_processors(policy.config, dataset_stats=statistics(policy))):
        part.save_pretrained(folder)
    return folder


NAMES = {"MEAN_STD": ("mean", "std"), "MIN_MAX": ("min", "max"), "IDENTITY": ()}


def buffers(policy, modes):
    """Statistics as LeRobot kept them beside the weights until 0.3."""
    found = {}
    for key, stats in statistics(policy).items():
        sides = ("normalize_targets", "unnormalize_outputs") if key == "action" else ("normalize_inputs",)
        for side in sides:
            for name in NAMES[modes[key]]:
                found[f"{side}.buffer_{key.replace('.', '_')}.{name}"] = stats[name].clone()
    return found


def modes_of(policy):
    features = {**policy.config.input_features, **policy.config.output_features}
    mapping = policy.config.normalization_mapping
    mode = {
        key: mapping.get(feature.type.value, NormalizationMode.IDENTITY) for key, feature in features.items()
    }
    return {key: value.value for key, value in mode.items()}


def save_old(policy, folder):
    """A checkpoint of LeRobot 0.1 to 0.3: settings as now, statistics beside the weights."""
    save(policy, folder)
    for file in folder.glob("policy_*"):
        file.unlink()
    weights = folder / "model.safetensors"
    save_file(load_file(weights) | buffers(policy, modes_of(policy)), weights)
    settings = json.loads((folder / "config.json").read_text())
    for name in ("use_peft", "pretrained_path", "pretrained_revision"):  # younger than these checkpoints
        settings.pop(name, None)
    (folder / "config.json").write_text(json.dumps(settings))
    return folder


def save_first(policy, folder):
    """A checkpoint of LeRobot's first versions: settings by shapes, no type, an older name of a weight."""
    save_old(policy, folder)
    settings = json.loads((folder / "config.json").read_text())
    modes = {key: mode.lower() for key, mode in modes_of(policy).items() if mode != "IDENTITY"}
    for side in ("input", "output"):
        shapes = {key: feature["shape"] for key, feature in settings.pop(f"{side}_features").items()}
        settings[f"{side}_shapes"] = shapes
        settings[f"{side}_normalization_modes"] = {key: modes[key] for key in shapes if key in modes}
    del settings["type"], settings["normalization_mapping"], settings["temporal_ensemble_coeff"]
    for name in ("device", "use_amp", "push_to_hub", "repo_id", "private", "tags", "license"):
        settings.pop(name, None)
    settings |= {"temporal_ensemble_momentum": None, "replace_final_stride_with_dilation": 0}
    (folder / "config.json").write_text(json.dumps(settings))
    weights = load_file(folder / "model.safetensors")
    position = "model.encoder_1d_feature_pos_embed.weight"
    weights[position.replace("1d_feature", "robot_and_latent")] = weights.pop(position)
    save_file(weights, folder / "model.safetensors")
    return folder
