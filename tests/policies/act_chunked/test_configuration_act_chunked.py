import json
import re

import draccus
import pytest
from draccus.utils import DecodingError
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.optim.schedulers import CosineAnnealingWithWarmupSchedulerConfig
from lerobot.policies.act.configuration_act import ACTConfig

from lerobot_act_chunking.errors import ConfigurationError, FeatureError
from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig

ACTION = {"action": PolicyFeature(FeatureType.ACTION, (4,))}
STATE = {"observation.state": PolicyFeature(FeatureType.STATE, (6,))}


def make(**settings):
    return ActChunkedConfig(device="cpu", push_to_hub=False, **settings)


def test_the_paper_preset_is_lerobots_act():
    ours, theirs = make(preset="paper"), ACTConfig(device="cpu", push_to_hub=False)
    shared = {name for name in vars(theirs) if hasattr(ours, name)} - {"pretrained_backbone_weights"}
    assert {name: getattr(ours, name) for name in shared} == {name: getattr(theirs, name) for name in shared}
    assert ours.get_optimizer_preset() == theirs.get_optimizer_preset()
    assert ours.get_scheduler_preset() is theirs.get_scheduler_preset() is None
    assert (ours.norm_std_floor, ours.backbone_norm, ours.actions_per_query) == (0, "frozen_batch", 1)


def test_every_setting_of_lerobots_act_is_known_but_one():
    assert set(vars(ACTConfig(device="cpu"))) - set(vars(make())) == {"replace_final_stride_with_dilation"}


def test_the_base_preset():
    config = make()
    assert (config.pre_norm, config.feedforward_activation, config.use_vae) == (True, "gelu", False)
    assert config.get_optimizer_preset().betas == (0.9, 0.95)
    assert config.get_scheduler_preset() == CosineAnnealingWithWarmupSchedulerConfig(200)
    assert config.normalization_mapping["ENV"] is NormalizationMode.MEAN_STD


def test_the_feed_forward_width_follows_the_token_width():
    assert make(dim_model=128).dim_feedforward == 512
    assert make(dim_model=128, dim_feedforward=96).dim_feedforward == 96


def test_explicit_values_win_over_the_preset():
    config = make(preset="paper", pre_norm=True, use_vae=False, norm_std_floor=0.5, optimizer_lr=1e-3)
    assert (config.pre_norm, config.use_vae, config.norm_std_floor, config.optimizer_lr) == (
        True,
        False,
        0.5,
        1e-3,
    )
    assert config.dim_feedforward == 3200


def test_feature_types_not_named_keep_their_normalisation():
    mapping = make(normalization_mapping={"STATE": NormalizationMode.IDENTITY}).normalization_mapping
    assert mapping == make().normalization_mapping | {"STATE": NormalizationMode.IDENTITY}


def test_executed_steps_follow_the_chunk():
    assert make(chunk_size=40).n_action_steps == 40
    assert make(chunk_size=40, chunk_stride=3).n_action_steps == 118


def test_a_single_action_is_executed_open_loop():
    assert make(chunk_size=1).execution == make(n_action_steps=1).execution == "open_loop"
    assert make(preset="paper").execution == "open_loop"


def test_execution_modes_fill_in_their_own_defaults():
    config = make(chunk_size=40)
    settings = config.execution_settings
    assert (settings.execution, settings.replan_interval, settings.crossfade_steps) == ("crossfade", 10, 20)
    config.execution = "ensemble"
    settings = config.execution_settings
    assert (settings.replan_interval, settings.temporal_ensemble_coeff) == (10, 0.01)
    assert config.temporal_ensemble_coeff is None  # so that another mode can be chosen later


def test_a_trained_policy_changes_its_execution_on_the_command_line(tmp_path):
    make(n_action_steps=60).save_pretrained(tmp_path)
    config = PreTrainedConfig.from_pretrained(
        tmp_path,
        cli_overrides=[
            "--execution=ensemble",
            "--replan_interval=7",
            "--ensemble_weighting=recency",
            "--temporal_ensemble_coeff=0.1",
            "--latency_steps=2",
            "--gripper_dims=[6, 13]",
        ],
    )
    assert config.execution_settings.weight_growth == -0.1
    config.save_pretrained(tmp_path)
    back = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--temporal_ensemble_coeff=null"])
    assert back.temporal_ensemble_coeff is None
    assert back.execution_settings.gripper_dims == (6, 13)


def test_pretrained_weights_choose_frozen_batch_norm():
    weights = "ResNet18_Weights.IMAGENET1K_V1"
    assert make().backbone_norm == "group"
    assert make(pretrained_backbone_weights=weights).backbone_norm == "frozen_batch"


def test_a_saved_config_holds_plain_values(tmp_path):
    make(preset="paper").save_pretrained(tmp_path)
    stored = json.loads((tmp_path / "config.json").read_text())
    assert stored["type"] == "act_chunked"
    assert stored["dim_feedforward"] == 3200
    assert stored["n_action_steps"] == 100


def test_the_command_line_reads_every_kind_of_setting(tmp_path):
    make().save_pretrained(tmp_path)
    config = PreTrainedConfig.from_pretrained(
        tmp_path,
        cli_overrides=[
            "--chunk_stride=2",
            "--n_action_steps=10",
            "--optimizer_betas=[0.8, 0.9]",
            "--lr_schedule=constant",
            "--vision_backbone=small_cnn",
            '--normalization_mapping={"STATE": "MIN_MAX"}',
        ],
    )
    assert (config.chunk_stride, config.n_action_steps) == (2, 10)
    assert config.get_optimizer_preset().betas == (0.8, 0.9)
    assert config.vision_backbone == "small_cnn"
    assert config.normalization_mapping["STATE"] is NormalizationMode.MIN_MAX


def test_a_constant_rate_may_warm_up():
    assert make(lr_schedule="constant", lr_warmup_steps=0).get_scheduler_preset() is None
    assert make(lr_schedule="constant", lr_warmup_steps=7).get_scheduler_preset().num_warmup_steps == 7


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"preset": "papre"}, "unknown preset 'papre'; choose one of: base, paper"),
        ({"vision_backbone": "vgg"}, "unknown vision_backbone 'vgg'; choose one of: small_cnn, resnet18"),
        ({"pad_normalization": "some"}, "unknown pad_normalization 'some'; choose one of: valid, all"),
        ({"n_action_steps": 101}, "n_action_steps=101 exceeds the 100 control steps of a chunk"),
        ({"chunk_stride": 0}, "chunk_stride=0 must be at least 1"),
        ({"execution": "coherence"}, "act_chunked predicts a single one"),
        ({"execution": "average"}, "unknown execution 'average'; choose one of: open_loop, receding"),
        (
            {"temporal_ensemble_coeff": 0.01},
            "temporal_ensemble_coeff=0.01 has no effect with execution=crossfade",
        ),
        (
            {"temporal_ensemble_coeff": -0.01, "execution": "ensemble"},
            "temporal_ensemble_coeff=-0.01 must be at least 0",
        ),
        ({"chunk_size": 0}, "chunk_size=0 must be at least 1"),
        ({"actions_per_query": 7}, "chunk_size=100 must be divisible by actions_per_query=7"),
        ({"actions_per_query": 0}, "actions_per_query=0 must be at least 1"),
        ({"dim_model": 100}, "dim_model=100 must be divisible by n_heads=8"),
        ({"dim_model": 18, "n_heads": 2}, "dim_model=18 must be a multiple of 4"),
        ({"n_encoder_layers": 0}, "n_encoder_layers=0 must be at least 1"),
        ({"latent_dim": 0, "use_vae": True}, "latent_dim=0 must be at least 1"),
        ({"dropout": 1.0}, "dropout=1.0 must be at least 0 and below 1"),
        ({"ema_max_value": 1.5}, "ema_max_value=1.5 must be at least 0 and below 1"),
        ({"kl_weight": -1.0}, "kl_weight=-1.0 must be at least 0"),
        ({"norm_std_floor": float("nan")}, "norm_std_floor=nan must be a finite number, at least 0"),
        (
            {"execution": "ensemble", "n_action_steps": 1},
            "needs overlapping chunks: replan_interval=1 must be below n_action_steps=1",
        ),
        (
            {"pretrained_backbone_weights": "ResNet18_Weights.IMAGENET1K_V1", "backbone_norm": "group"},
            "another backbone_norm than group: set --policy.backbone_norm=frozen_batch",
        ),
    ],
)
def test_settings_that_cannot_work(settings, message):
    with pytest.raises(ConfigurationError, match=re.escape(message)):
        make(**settings)


VAE = {"use_vae": True}
SAMPLED = VAE | {"z_inference": "sample"}
MEAN_STD = {"ACTION": NormalizationMode.MEAN_STD}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"n_obs_steps": 0}, "n_obs_steps=0 must be at least 1"),
        ({"obs_stride": 0}, "obs_stride=0 must be at least 1"),
        ({"obs_stride": 5}, "obs_stride=5 needs n_obs_steps of 2 or more"),
        ({"history_image_grid": 0}, "history_image_grid=0 must be at least 1"),
        (
            {"history_dropout": 0.2},
            "history_dropout=0.2 needs earlier observations: set --policy.n_obs_steps",
        ),
        ({"history_dropout": 1.0, "n_obs_steps": 2}, "history_dropout=1.0 must be at least 0 and below 1"),
        ({"use_velocity": True}, "use_velocity=True needs earlier observations: set --policy.n_obs_steps"),
        (
            {"image_tokens": "summary", "n_obs_steps": 2},
            "image_tokens=summary reads the current image alone, but n_obs_steps=2",
        ),
        ({"n_decoder_layers": 0}, "n_decoder_layers=0 must be at least 1"),
        ({"teacher_dropout": 1.0}, "teacher_dropout=1.0 must be at least 0 and below 1"),
        ({"teacher_noise_std": -0.1}, "teacher_noise_std=-0.1 must be at least 0"),
        ({"noise_seed": -1}, "noise_seed=-1 must be at least 0"),
    ],
)
def test_observations_and_decoders_that_cannot_work(settings, message):
    with pytest.raises(ConfigurationError, match=re.escape(message)):
        make(**settings)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"action_likelihood": "gaussian", "nll_beta": 2.0}, "nll_beta=2.0 must be at least 0 and at most 1"),
        ({"action_likelihood": "laplace", "min_std": 0.0}, "min_std=0.0 must be above 0 and below 1"),
        ({"action_likelihood": "gmm", "n_components": 0}, "n_components=0 must be at least 1"),
        ({"action_likelihood": "categorical", "n_bins": 3}, "n_bins=3 must be at least"),
        (
            {"action_likelihood": "categorical", "hl_gauss_sigma": -1.0},
            "hl_gauss_sigma=-1.0 must be at least",
        ),
        (
            {"action_likelihood": "categorical", "soft_local_bins": -1},
            "soft_local_bins=-1 must be at least 0",
        ),
        (
            {"action_likelihood": "categorical", "normalization_mapping": MEAN_STD},
            "action_likelihood=categorical predicts actions in [-1, 1], but actions are normalised by MEAN",
        ),
        (
            {"action_likelihood": "categorical", "action_top_k": 4},
            "action_top_k=4 limits what is sampled, but with action_temperature=0 nothing is",
        ),
        (
            {"action_likelihood": "categorical", "action_temperature": 1.0, "action_top_k": 300},
            "action_top_k=300 must be at most n_bins=256: 0 takes all",
        ),
        ({"action_temperature": 1.0}, "action_temperature=1.0, but l1 predicts one action"),
        (
            {"action_likelihood": "gaussian", "action_temperature": -1.0},
            "action_temperature=-1.0 must be at least 0 and at most 100",
        ),
    ],
)
def test_likelihoods_that_cannot_work(settings, message):
    with pytest.raises(ConfigurationError, match=re.escape(message)):
        make(**settings)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (VAE | {"n_latent_components": 1}, "n_latent_components=1 must be at least 2"),
        (VAE | {"latent_warmup_steps": 0}, "latent_warmup_steps=0 must be at least 1"),
        (
            SAMPLED | {"z_temperature": 0.0},
            "z_temperature=0.0 must be above 0 and at most 100: set z_temperature=1",
        ),
        (VAE | {"n_vae_encoder_layers": 0}, "n_vae_encoder_layers=0 must be at least 1"),
        (VAE | {"vae_action_stride": 0}, "vae_action_stride=0 must be at least 1"),
        (VAE | {"vae_action_stride": 101}, "vae_action_stride=101 averages more actions than the chunk has"),
        (VAE | {"kl_anneal": "linear", "kl_anneal_steps": 0}, "kl_anneal_steps=0 must be at least 1"),
        (VAE | {"free_bits": -0.1}, "free_bits=-0.1 must be at least 0"),
        (SAMPLED | {"z_hold_steps": -1}, "z_hold_steps=-1 must be at least 0"),
        (SAMPLED | {"z_hold": "steps"}, "z_hold=steps and z_hold_steps=0 contradict each other"),
        (SAMPLED | {"z_hold_steps": 7}, "z_hold=episode and z_hold_steps=7 contradict each other"),
        (
            SAMPLED | {"z_hold": "chunk", "execution": "ensemble"},
            "z_hold=chunk samples a new latent while execution=ensemble averages chunks of older ones",
        ),
        (
            SAMPLED | {"z_hold": "steps", "z_hold_steps": 7, "execution": "ensemble"},
            "z_hold=steps samples a new latent while execution=ensemble averages",
        ),
        (VAE | {"execution": "coherence"}, "act_chunked predicts a single one: set --policy.use_vae=true"),
        (
            SAMPLED | {"execution": "coherence"},
            "execution=coherence chooses anew among sampled chunks, z_hold=episode keeps",
        ),
    ],
)
def test_latents_that_cannot_work(settings, message):
    with pytest.raises(ConfigurationError, match=re.escape(message)):
        make(**settings)


@pytest.mark.parametrize(
    "settings",
    [
        SAMPLED | {"z_hold": "chunk", "execution": "ensemble", "allow_mode_mixing": True},
        SAMPLED | {"z_hold": "episode", "execution": "ensemble"},
        SAMPLED | {"z_hold": "chunk", "execution": "coherence"},
        {"action_likelihood": "gmm", "action_temperature": 1.0, "execution": "coherence"},
        {"action_likelihood": "categorical"},
        {"preset": "autoregressive"},
    ],
)
def test_neighbours_of_what_is_refused_work(settings):
    config = make(**settings)
    assert {name: getattr(config, name) for name in settings} == settings


@pytest.mark.parametrize(
    "name",
    [
        "decoder_type",
        "action_likelihood",
        "latent_type",
        "prior_component_weights",
        "z_inference",
        "z_hold",
        "style_observations",
        "kl_anneal",
        "image_tokens",
    ],
)
def test_an_unknown_choice_is_named_with_those_there_are(name):
    with pytest.raises(ConfigurationError, match=f"unknown {name} 'other'; choose one of: "):
        make(**{name: "other"})


def test_vectors_are_read_in_a_fixed_order():
    inputs = {
        "observation.environment_state": PolicyFeature(FeatureType.ENV, (7,)),
        "observation.velocity": PolicyFeature(FeatureType.STATE, (3,)),
        "observation.effort": PolicyFeature(FeatureType.STATE, (2,)),
        **STATE,
    }
    spec = make(input_features=inputs, output_features=ACTION).feature_spec
    assert list(spec.vectors) == [
        "observation.state",
        "observation.effort",
        "observation.velocity",
        "observation.environment_state",
    ]


@pytest.mark.parametrize(
    ("inputs", "outputs", "message"),
    [
        ({}, ACTION, "at least one state vector or camera"),
        (STATE, {}, "needs an output feature 'action'"),
        (
            {"observation.state": PolicyFeature(FeatureType.STATE, (2, 3))},
            ACTION,
            "must be a vector of one value or more, but its shape is (2, 3)",
        ),
        (
            {"observation.images.depth": PolicyFeature(FeatureType.VISUAL, (1, 8, 8))},
            ACTION,
            "must be an image of shape (3, height, width), but its shape is (1, 8, 8)",
        ),
    ],
)
def test_features_that_cannot_work(inputs, outputs, message):
    with pytest.raises(FeatureError, match=re.escape(message)):
        make(input_features=inputs, output_features=outputs).validate_features()


def test_a_run_whose_push_cannot_succeed_is_refused_at_its_start(monkeypatch):
    monkeypatch.delenv("LEROBOT_LOCAL_HUB", raising=False)
    config = ActChunkedConfig(device="cpu")
    with pytest.raises(ConfigurationError, match=r"this run would push[\s\S]*push_to_hub=false"):
        config.get_optimizer_preset()


def test_lerobots_command_line_shows_the_reason():
    settings = ["--policy.type=act_chunked", "--policy.execution=crossfade", "--policy.crossfade_steps=90"]
    with pytest.raises(DecodingError, match="crossfade_steps=90 must be between 1 and the overlap"):
        draccus.parse(TrainPipelineConfig, args=["--dataset.repo_id=local/none", *settings])


def test_a_preset_of_an_earlier_checkpoint_keeps_its_meaning():
    assert make(preset="lecture") == make(preset="autoregressive")
