"""Imported checkpoints of every kind act and learn as the policies of LeRobot that wrote them."""

import hashlib
from itertools import product

import pytest
import torch
from act_checkpoints import A, B, T, make_act, save, save_first, save_old, statistics
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from lerobot.policies.factory import make_pre_post_processors
from tiers import some

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.act_chunked.importing.conversion import import_checkpoint
from lerobot_act_chunking.policies.loading import load_policy


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
def test_it_goes_on_learning_as_lerobots(inputs, tmp_path, monkeypatch):
    theirs = make_act(inputs)
    ours = import_checkpoint(save(theirs, tmp_path / "act"), tmp_path / "imported").loaded.policy
    batch = raw_batch(theirs) | {
        "action": torch.randn(B, T, A, generator=torch.Generator().manual_seed(3)),
        "action_is_pad": torch.arange(T) >= torch.tensor([[T], [2], [4]]),
    }
    noise = torch.randn(B, 8)  # of the style latent; ours draws one more
    monkeypatch.setattr(torch, "randn_like", lambda _: noise)
    monkeypatch.setattr(torch, "randn", lambda *_, **__: torch.nn.functional.pad(noise, (0, 1)))
    losses = []
    for policy in (theirs, ours):
        loss, _ = policy.train().forward(batch)
        losses.append(loss.item())
    assert losses[1] == pytest.approx(losses[0], rel=1e-5)
    for name in ("optimizer_lr", "optimizer_weight_decay", "optimizer_lr_backbone", "kl_weight", "dropout"):
        assert getattr(ours.config, name) == getattr(theirs.config, name), name


OLD = {"old": save_old, "first": save_first}
MIN_MAX = {"VISUAL": "MEAN_STD", "STATE": "MIN_MAX", "ENV": "MIN_MAX", "ACTION": "MIN_MAX"}


@pytest.mark.parametrize(("version", "inputs"), some(2, [*product(OLD, ["state+cameras"]), ("old", "all")]))
@pytest.mark.parametrize("mapping", [None, MIN_MAX], ids=["default", "min_max"])
def test_checkpoints_from_before_the_processors(version, inputs, mapping, tmp_path):
    """LeRobot's own class and processors, given the same weights and statistics, say what they did."""
    settings = {} if mapping is None else {"normalization_mapping": _modes(mapping)}
    theirs = make_act(inputs, **settings)
    source = OLD[version](theirs, tmp_path / "act")
    with pytest.raises(ConfigurationError):
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
