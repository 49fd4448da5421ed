"""Settings of `diffusion_chunked`: what follows from what, and what is refused before any training."""

import pytest
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig

from lerobot_act_chunking.errors import ConfigurationError, FeatureError
from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)

INPUTS = {
    "observation.state": PolicyFeature(FeatureType.STATE, (6,)),
    "observation.environment_state": PolicyFeature(FeatureType.ENV, (7,)),
}
OUTPUTS = {"action": PolicyFeature(FeatureType.ACTION, (4,))}


def config(**settings):
    return DiffusionChunkedConfig(device="cpu", push_to_hub=False, **settings)


def with_features(**settings):
    return config(input_features=dict(INPUTS), output_features=dict(OUTPUTS), **settings)


@pytest.mark.parametrize(
    ("objective", "sampler", "steps", "clipped"),
    [("flow", "euler", 5, False), ("ddpm", "ddim", 10, True), ("two_step", "two_step", 2, False)],
)
def test_sampling_follows_from_the_objective(objective, sampler, steps, clipped):
    made = config(objective=objective)
    assert (made.sampler, made.num_inference_steps, made.clip_sample) == (sampler, steps, clipped)


def test_noise_prediction_normalises_actions_to_the_range_it_clips_to():
    assert config(objective="ddpm").normalization_mapping["ACTION"] is NormalizationMode.MIN_MAX
    assert config(objective="flow").normalization_mapping["ACTION"] is NormalizationMode.MEAN_STD


def test_the_paper_preset_has_the_defaults_of_lerobots_diffusion():
    ours, theirs = config(preset="paper"), DiffusionConfig(device="cpu", push_to_hub=False)
    same = """n_obs_steps horizon n_action_steps normalization_mapping down_dims kernel_size n_groups
        diffusion_step_embed_dim use_film_scale_modulation num_train_timesteps beta_schedule beta_start
        beta_end prediction_type clip_sample clip_sample_range do_mask_loss_for_padding optimizer_lr
        optimizer_betas optimizer_weight_decay observation_delta_indices action_delta_indices"""
    for name in same.split():
        assert getattr(ours, name) == getattr(theirs, name), name
    assert (ours.sampler, ours.num_inference_steps) == ("ddpm", theirs.num_train_timesteps)


def test_a_given_value_wins_over_the_preset():
    made = config(preset="paper", sampler="ddim", num_inference_steps=7, horizon=32, n_action_steps=8)
    assert (made.sampler, made.num_inference_steps, made.horizon) == ("ddim", 7, 32)


@pytest.mark.parametrize(
    ("size", "dims"),
    [("S", (64, 128, 256)), ("M", (128, 256, 512)), ("L", (256, 512, 1024)), ("XL", (512, 1024, 2048))],
)
def test_sizes_of_the_unet(size, dims):
    assert config(denoiser="unet1d", unet_size=size).down_dims == dims
    assert config(denoiser="unet1d", unet_size=size, down_dims=(8, 16)).down_dims == (8, 16)


@pytest.mark.parametrize(("horizon", "per_token"), [(100, 5), (64, 4), (16, 4), (9, 3), (7, 1)])
def test_tokens_take_as_many_actions_as_divide_the_horizon(horizon, per_token):
    assert config(horizon=horizon, chunk_stride=1).actions_per_token == per_token


def test_a_chunk_begins_now_or_at_the_first_observation():
    now = config(horizon=8, chunk_stride=3, n_obs_steps=2)
    assert now.action_delta_indices == [0, 3, 6, 9, 12, 15, 18, 21]
    assert (now.observation_delta_indices, now.n_action_steps) == ([-1, 0], 22)
    first = config(horizon=8, chunk_stride=1, n_obs_steps=3, align="first_obs")
    assert first.action_delta_indices == [-2, -1, 0, 1, 2, 3, 4, 5]
    assert first.n_action_steps == first.timing.control_steps == 6


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"preset": "big"}, "preset"),
        ({"objective": "gan"}, "objective"),
        ({"denoiser": "mlp"}, "denoiser"),
        ({"horizon": 0}, "horizon=0 must be at least 1"),
        ({"horizon": 2, "n_obs_steps": 3, "align": "first_obs"}, "it must be at least 3"),
        ({"horizon": 16, "chunk_stride": 1, "n_action_steps": 17}, "set horizon=17 or more"),
        ({"horizon": 5, "chunk_stride": 3, "n_action_steps": 14}, "set horizon=6 or more"),
        ({"align": "first_obs", "n_obs_steps": 2, "chunk_stride": 2}, "chunk_stride=2 needs align=current"),
        ({"denoiser": "unet1d", "horizon": 18}, "horizon=18 must be a multiple of 4"),
        ({"denoiser": "unet1d", "down_dims": (12, 24)}, r"multiples of n_groups=8"),
        ({"denoiser": "unet1d", "kernel_size": 4}, "kernel_size=4 must be odd"),
        ({"horizon": 9, "actions_per_token": 2}, "horizon=9 must be divisible by actions_per_token=2"),
        ({"denoiser": "dit", "dim_model": 12}, "dim_model=12 must be divisible by n_heads=8"),
        ({"dim_model": 18}, "dim_model=18 must be a multiple of 4"),
        ({"prediction_type": "epsilon"}, "prediction_type=epsilon does not go with objective=flow"),
        ({"sampler": "ddim"}, "unknown sampler for flow"),
        ({"objective": "ddpm", "num_inference_steps": 101}, "101"),
        ({"objective": "ddpm", "sampler": "dpm++", "num_inference_steps": 51}, "51"),
        ({"num_inference_steps": 0}, "num_inference_steps=0 must be at least 1"),
        ({"objective": "ddpm", "clip_sample_range": 0.0}, "clip_sample_range=0.0 must be above 0"),
        ({"warm_start": "rtc", "align": "first_obs", "n_obs_steps": 2}, "warm_start=rtc needs align=current"),
        ({"warm_start": "rtc", "objective": "two_step"}, "objective=two_step uses none"),
        ({"warm_start": "prefix"}, "needs a policy trained with prefix_steps > 0"),
        ({"denoiser": "unet1d", "prefix_steps": 4}, "set denoiser=dit or denoiser=mixer"),
        ({"warm_start": "prefix", "prefix_steps": 2, "latency_steps": 3}, "latency_steps=3"),
        ({"prefix_steps": 100}, "prefix_steps=100 leaves nothing to predict"),
        ({"warm_start": "noise_hold", "chunk_stride": 2, "replan_interval": 5}, "must be a multiple of"),
        ({"sdedit_strength": 0.0}, "sdedit_strength=0.0"),
        ({"max_guidance_weight": 0.0}, "max_guidance_weight=0.0"),
        ({"condition_dropout": 0.1}, "none are named"),
        ({"guidance_scale": 2.0}, "needs a policy trained with condition_dropout"),
        ({"execution": "coherence", "objective": "two_step"}, "predicts a single one"),
        ({"dropout": 1.0}, "dropout=1.0"),
        ({"pretrained_backbone_weights": "x", "backbone_norm": "group"}, "backbone_norm=frozen_batch"),
    ],
)
def test_what_cannot_work_is_refused_with_the_fix(settings, message):
    with pytest.raises(ConfigurationError, match=message):
        config(**settings)


def test_guidance_features_must_be_inputs():
    made = with_features(guidance_features=["observation.goal"], condition_dropout=0.1)
    with pytest.raises(
        FeatureError, match=r"names 'observation\.goal', but the inputs are: observation\.state"
    ):
        made.validate_features()


def test_no_input_at_all_is_refused():
    made = config(output_features=dict(OUTPUTS))
    with pytest.raises(FeatureError, match="at least one state vector or camera"):
        made.validate_features()


def test_saved_and_loaded_it_is_the_same(tmp_path):
    made = with_features(objective="ddpm", denoiser="unet1d", horizon=16, warm_start="rtc")
    made.save_pretrained(tmp_path)
    assert PreTrainedConfig.from_pretrained(tmp_path) == made


def test_seconds_do_not_count_predictions_before_the_current_step():
    made = config(preset="paper", fps=10, horizon_s=1.5, n_action_steps=8)
    assert (made.n_obs_steps, made.horizon, made.timing.chunk_size) == (2, 16, 15)
