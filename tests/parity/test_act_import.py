"""Imported checkpoints of every kind act and learn as the policies of LeRobot that wrote them."""

import hashlib
import json
from itertools import product

import pytest
import torch
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors
from lerobot.processor.pipeline import ProcessorMigrationError
from safetensors.torch import load_file, save_file

from lerobot_act_chunking.policies.act_chunked.importing.conversion import import_checkpoint
from lerobot_act_chunking.policies.loading import load_policy

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


def raw_batch(policy):
    generator = torch.Generator().manual_seed(2)
    return {
        key: torch.rand(B, *feature.shape, generator=generator)
        for key, feature in policy.config.input_features.items()
    }


def assert_close(actual, expected):
    torch.testing.assert_close(actual, expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("inputs", "settings"),
    [
        ("state+environment", {}),
        ("state+environment", {"pre_norm": True, "n_decoder_layers": 3, "use_vae": False}),
        ("environment", {"n_decoder_layers": 2, "feedforward_activation": "gelu"}),
        ("state+cameras", {"pre_norm": True}),
        ("cameras", {"use_vae": False, "vision_backbone": "resnet34"}),
        ("all", {"n_action_steps": 2, "dropout": 0.1, "kl_weight": 3.0}),
    ],
)
def test_the_imported_policy_acts_as_lerobots(inputs, settings, tmp_path):
    theirs = make_act(inputs, **settings)
    source = save(theirs, tmp_path / "act")
    imported = import_checkpoint(source, tmp_path / "imported")
    assert imported.difference < 1e-5
    ours, preprocess, postprocess = load_policy(tmp_path / "imported")
    _, their_preprocess, their_postprocess = load_policy(source)
    for k in range(T + 2):
        raw = {key: value + 0.1 * k for key, value in raw_batch(theirs).items()}
        raw.setdefault("observation.state", torch.zeros(B, 1))  # LeRobot's act looks there for its device
        actual = postprocess(ours.select_action(preprocess(raw)))
        assert_close(actual, their_postprocess(theirs.select_action(their_preprocess(raw))))


@pytest.mark.parametrize("coeff", [0.01, 0.0, -0.3])
def test_lerobots_ensemble_becomes_ours(coeff, tmp_path):
    theirs = make_act("state+environment", temporal_ensemble_coeff=coeff, n_action_steps=1)
    ours = import_checkpoint(save(theirs, tmp_path / "act"), tmp_path / "imported").loaded.policy
    settings = ours.config.execution_settings
    assert (settings.execution, settings.replan_interval, settings.n_action_steps) == ("ensemble", 1, T)
    assert settings.weight_growth == coeff
    batch = raw_batch(theirs)
    for k in range(2 * T):
        step = {key: value + k for key, value in batch.items()}
        assert_close(ours.select_action(step), theirs.select_action(step))


@pytest.mark.parametrize("inputs", ["state+environment", "state+cameras"])
def test_it_goes_on_learning_as_lerobots(inputs, tmp_path):
    theirs = make_act(inputs)
    ours = import_checkpoint(save(theirs, tmp_path / "act"), tmp_path / "imported").loaded.policy
    batch = raw_batch(theirs) | {
        "action": torch.randn(B, T, A, generator=torch.Generator().manual_seed(3)),
        "action_is_pad": torch.arange(T) >= torch.tensor([[T], [2], [4]]),
    }
    losses = []
    for policy in (theirs, ours):
        torch.manual_seed(4)
        loss, _ = policy.train().forward(batch)
        losses.append(loss.item())
    assert losses[1] == pytest.approx(losses[0], rel=1e-5)
    for name in ("optimizer_lr", "optimizer_weight_decay", "optimizer_lr_backbone", "kl_weight", "dropout"):
        assert getattr(ours.config, name) == getattr(theirs.config, name), name


OLD = {"old": save_old, "first": save_first}
MIN_MAX = {"VISUAL": "MEAN_STD", "STATE": "MIN_MAX", "ENV": "MIN_MAX", "ACTION": "MIN_MAX"}


@pytest.mark.parametrize(("version", "inputs"), [*product(OLD, ["state+cameras"]), ("old", "all")])
@pytest.mark.parametrize("mapping", [None, MIN_MAX], ids=["default", "min_max"])
def test_checkpoints_from_before_the_processors(version, inputs, mapping, tmp_path):
    """LeRobot's own class and processors, given the same weights and statistics, say what they did."""
    settings = {} if mapping is None else {"normalization_mapping": _modes(mapping)}
    theirs = make_act(inputs, **settings)
    source = OLD[version](theirs, tmp_path / "act")
    with pytest.raises((ProcessorMigrationError, ValueError)):
        load_policy(source)
    import_checkpoint(source, tmp_path / "imported")
    ours, preprocess, postprocess = load_policy(tmp_path / "imported")
    before, behind = make_pre_post_processors(theirs.config, dataset_stats=statistics(theirs))
    raw = raw_batch(theirs)
    assert_close(
        postprocess(ours.predict_action_chunk(preprocess(raw))),
        behind(theirs.predict_action_chunk(before(raw))),
    )


def _modes(mapping):
    return {name: NormalizationMode(mode) for name, mode in mapping.items()}


def test_old_statistics_are_applied_as_lerobot_did(tmp_path):
    """By hand: (x - mean) / (std + 1e-8) before the network, y * std + mean behind it."""
    theirs = make_act("state+cameras")
    import_checkpoint(save_old(theirs, tmp_path / "act"), tmp_path / "imported")
    ours, preprocess, postprocess = load_policy(tmp_path / "imported")
    raw, stats = raw_batch(theirs), statistics(theirs)
    normal = {key: (x - stats[key]["mean"]) / (stats[key]["std"] + 1e-8) for key, x in raw.items()}
    expected = theirs.predict_action_chunk(normal) * stats["action"]["std"] + stats["action"]["mean"]
    assert_close(postprocess(ours.predict_action_chunk(preprocess(raw))), expected)


def test_the_source_is_only_read(tmp_path):
    source = save_first(make_act("state+cameras"), tmp_path / "act")
    before = digests(source)
    import_checkpoint(source, tmp_path / "imported")
    assert digests(source) == before


def digests(folder):
    return {
        file.name: hashlib.sha256(file.read_bytes()).hexdigest()
        for file in folder.rglob("*")
        if file.is_file()
    }


def test_vectors_that_lerobot_ignores_are_left_out(tmp_path):
    theirs = make_act("state+environment")
    theirs.config.input_features["observation.effort"] = PolicyFeature(FeatureType.STATE, (2,))
    ours = import_checkpoint(save(theirs, tmp_path / "act"), tmp_path / "imported").loaded.policy
    assert list(ours.config.input_features) == ["observation.state", "observation.environment_state"]
