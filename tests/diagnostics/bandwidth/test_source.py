"""Which execution a checkpoint and options stand for."""

import json

import pytest
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.vqbet.configuration_vqbet import VQBeTConfig
from policy_cases import LENGTHS, TYPES

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.bandwidth.source import read_source
from lerobot_act_chunking.errors import ConfigurationError

FEATURES = {
    "input_features": {"observation.state": PolicyFeature(FeatureType.STATE, (6,))},
    "output_features": {"action": PolicyFeature(FeatureType.ACTION, (4,))},
    "device": "cpu",
    "push_to_hub": False,
}


def ours(chunk_size, **settings):
    return PreTrainedConfig.get_choice_class(TYPES[0])(
        **{LENGTHS[TYPES[0]]: chunk_size}, **settings, **FEATURES
    )


def saved(config, folder):
    config._save_pretrained(folder)
    return str(folder)


def settings_of(config, folder, **overrides):
    return read_source(saved(config, folder), overrides).settings


def ensemble(chunk_size, interval, weighting, coeff, **others):
    return ExecutionSettings(
        chunk_size,
        "ensemble",
        replan_interval=interval,
        ensemble_weighting=weighting,
        temporal_ensemble_coeff=coeff,
        **others,
    )


def test_without_a_checkpoint_it_is_act():
    source = read_source(None, {"chunk_size": None, "temporal_ensemble_coeff": None})
    assert source.settings == ensemble(100, 1, "act", 0.01)
    assert source.checkpoint is source.policy_type is None


def test_options_win():
    overrides = {"chunk_size": 30, "replan_interval": 5, "ensemble_weighting": "recency", "latency_steps": 2}
    assert read_source(None, overrides).settings == ensemble(30, 5, "recency", 0.01, latency_steps=2)
    assert read_source(None, {"ensemble_weighting": "uniform"}).settings == ensemble(100, 1, "uniform", 0.0)
    assert read_source(None, {"crossfade_steps": 7}).settings.execution == "crossfade"


@pytest.mark.parametrize("options", [{"chunk_size": 1}, {"chunk_size": 20, "replan_interval": 20}])
@pytest.mark.parametrize("weights", [{}, {"ensemble_weighting": "act", "temporal_ensemble_coeff": 0.01}])
def test_an_ensemble_of_one_is_open_loop(options, weights):
    chunk_size = options["chunk_size"]
    assert read_source(None, options | weights).settings == ExecutionSettings(chunk_size)


def test_reads_the_execution_of_our_policies(tmp_path):
    config = ours(20, n_action_steps=16, execution="crossfade")
    source = read_source(saved(config, tmp_path), {})
    assert source.settings == config.execution_settings
    assert (source.policy_type, source.checkpoint) == (TYPES[0], str(tmp_path))
    assert settings_of(config, tmp_path, replan_interval=3).replan_interval == 3


def test_a_strided_chunk_counts_control_steps(tmp_path):
    config = ours(5, chunk_stride=4)
    assert settings_of(config, tmp_path).chunk_size == 17


def test_another_mode_keeps_the_chunk_and_forgets_the_rest(tmp_path):
    config = ours(
        20, n_action_steps=16, execution="crossfade", replan_interval=6, latency_steps=2, smoothing_steps=3
    )
    asked = settings_of(config, tmp_path, temporal_ensemble_coeff=0.05)
    assert asked == ensemble(20, 4, "act", 0.05, n_action_steps=16, latency_steps=2, smoothing_steps=3)
    shorter = settings_of(config, tmp_path, execution="open_loop", n_action_steps=8, latency_steps=0)
    assert shorter == ExecutionSettings(20, "open_loop", 8, smoothing_steps=3)


def test_an_option_replaces_the_weighting_and_its_coefficient(tmp_path):
    config = ours(20, execution="ensemble", temporal_ensemble_coeff=0.3, replan_interval=4)
    assert settings_of(config, tmp_path, ensemble_weighting="uniform") == ensemble(20, 4, "uniform", 0.0)
    assert settings_of(config, tmp_path, temporal_ensemble_coeff=0.2) == ensemble(20, 4, "act", 0.2)
    assert settings_of(config, tmp_path, chunk_size=12) == ensemble(12, 4, "act", 0.3)


@pytest.mark.parametrize(("coeff", "weighting"), [(0.02, "act"), (-0.02, "recency"), (0.0, "act")])
def test_reads_the_sign_of_lerobots_act(coeff, weighting, tmp_path):
    config = ACTConfig(chunk_size=20, n_action_steps=1, temporal_ensemble_coeff=coeff, **FEATURES)
    assert settings_of(config, tmp_path) == ensemble(20, 1, weighting, abs(coeff))


def test_reads_lerobots_queues(tmp_path):
    config = ACTConfig(chunk_size=20, n_action_steps=8, **FEATURES)
    assert settings_of(config, tmp_path) == ExecutionSettings(20, "open_loop", 8)
    images = {"observation.images.top": PolicyFeature(FeatureType.VISUAL, (3, 96, 96))}
    vqbet = VQBeTConfig(**{**FEATURES, "input_features": FEATURES["input_features"] | images})
    assert settings_of(vqbet, tmp_path) == ExecutionSettings(vqbet.action_chunk_size)


def test_a_missing_checkpoint_is_named(tmp_path):
    with pytest.raises(ConfigurationError, match="there is no checkpoint at"):
        read_source(str(tmp_path / "nowhere"), {})


def test_a_policy_without_chunks_is_refused(tmp_path):
    (tmp_path / "config.json").write_text(json.dumps({"type": "gaussian_actor"}))
    with pytest.raises(ConfigurationError, match="gaussian_actor"):
        read_source(str(tmp_path), {})
