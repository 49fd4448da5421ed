"""Settings of `vqbet_chunked`: what follows from what, and what is refused before any training."""

import pytest
import torch
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig
from lerobot.policies.vqbet.configuration_vqbet import VQBeTConfig

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked import VqbetChunkedConfig

MEAN_STD = {"ACTION": NormalizationMode.MEAN_STD}


def config(**settings):
    return VqbetChunkedConfig(device="cpu", push_to_hub=False, **settings)


def test_the_paper_preset_has_the_defaults_of_lerobots_vqbet():
    ours, theirs = config(preset="paper"), VQBeTConfig(device="cpu", push_to_hub=False)
    same = """n_obs_steps n_action_pred_token n_vqvae_training_steps vqvae_n_embed vqvae_embedding_dim
        vqvae_enc_hidden_dim gpt_n_layer gpt_n_head gpt_hidden_dim dropout offset_loss_weight
        primary_code_loss_weight secondary_code_loss_weight bet_softmax_temperature sequentially_select
        optimizer_lr optimizer_betas optimizer_weight_decay optimizer_vqvae_lr optimizer_vqvae_weight_decay
        spatial_softmax_num_keypoints observation_delta_indices action_delta_indices"""
    for name in same.split():
        assert getattr(ours, name) == getattr(theirs, name), name
    assert ours.chunk_size == theirs.action_chunk_size
    assert theirs.normalization_mapping.items() <= ours.normalization_mapping.items()


def test_a_given_value_wins_over_the_preset():
    made = config(preset="paper", chunk_size=7, gpt_n_layer=2, top_p=0.5)
    assert (made.chunk_size, made.gpt_n_layer, made.top_p) == (7, 2, 0.5)


@pytest.mark.parametrize(
    ("tokenizer", "mode"), [("uniform", "MIN_MAX"), ("dct", "MIN_MAX"), ("fsq", "MEAN_STD")]
)
def test_bins_want_a_range(tokenizer, mode):
    assert config(tokenizer=tokenizer).normalization_mapping["ACTION"].value == mode


def test_training_loads_the_actions_of_all_queries():
    made = config(n_obs_steps=2, chunk_size=3, chunk_stride=5, n_action_pred_token=2)
    assert made.action_delta_indices == [-1, 0, 1, 4, 5, 6, 9, 10, 11]
    assert made.observation_delta_indices == [-1, 0]


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"n_vqvae_training_steps": 7}, 7),
        ({"n_vqvae_training_steps": 7, "tokenizer": "dct"}, 0),
        ({"n_vqvae_training_steps": 7, "tokenizer_training": "joint", "use_ema": False}, 0),
    ],
)
def test_how_long_the_tokenizer_learns_alone(settings, expected):
    assert config(**settings).tokenizer_steps == expected


def factors(settings, n_steps):
    parameter = torch.nn.Parameter(torch.zeros(1))
    optimizer = torch.optim.SGD([parameter], lr=1.0)
    schedule = config(**settings).get_scheduler_preset().build(optimizer, n_steps)
    found = []
    for _ in range(n_steps + 1):
        found.append(schedule.get_last_lr()[0])
        optimizer.step()
        schedule.step()
    return found


def test_the_rate_warms_up_when_the_policy_begins_to_learn_and_ends_at_zero():
    settings = {"n_vqvae_training_steps": 4, "lr_warmup_steps": 2}
    found = factors({**settings, "lr_schedule": "cosine"}, 10)
    assert found == pytest.approx([1, 1, 1, 1, 0, 0.5, 1, 0.853553, 0.5, 0.146447, 0], abs=1e-6)
    constant = factors({**settings, "lr_schedule": "constant"}, 10)
    assert constant == pytest.approx([1, 1, 1, 1, 0, 0.5, 1, 1, 1, 1, 1])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"preset": "big"}, "preset"),
        ({"tokenizer": "bpe"}, "tokenizer"),
        ({"tokenizer_training": "later"}, "tokenizer_training"),
        ({"chunk_size": 0}, "chunk_size=0 must be at least 1"),
        ({"n_action_pred_token": 0}, "n_action_pred_token=0 must be at least 1"),
        ({"n_action_steps": 51, "chunk_size": 50, "chunk_stride": 1}, "n_action_steps=51"),
        ({"gpt_hidden_dim": 20, "gpt_n_head": 8}, "gpt_hidden_dim=20 must be divisible by gpt_n_head=8"),
        ({"head_hidden_dims": (64, 0)}, r"head_hidden_dims=\(64, 0\)"),
        ({"dropout": 1.0}, "dropout=1.0"),
        ({"top_p": 0.0}, "top_p=0.0 must be above 0 and at most 1"),
        ({"top_p": 1.5}, "top_p=1.5"),
        ({"bet_softmax_temperature": -1.0}, "bet_softmax_temperature=-1.0 must be at least 0"),
        ({"focal_gamma": -1.0}, "focal_gamma=-1.0 must be at least 0"),
        ({"vqvae_n_embed": 1}, "vqvae_n_embed=1"),
        ({"vqvae_num_layers": 0}, "vqvae_num_layers=0"),
        ({"vqvae_decay": 1.0}, "vqvae_decay=1.0"),
        ({"tokenizer": "fsq", "fsq_levels": (4, 1)}, "fsq_levels"),
        ({"tokenizer": "uniform", "n_bins": 1}, "n_bins=1"),
        ({"tokenizer": "dct", "chunk_size": 5, "dct_coefficients": 6}, "dct_coefficients=6"),
        ({"tokenizer": "uniform", "normalization_mapping": MEAN_STD}, r"bins in \[-1, 1\].*MIN_MAX"),
        ({"tokenizer": "dct", "offset_mode": "table"}, "set offset_mode=code_conditioned"),
        ({"tokenizer": "dct", "tokenizer_training": "joint"}, "nothing to learn"),
        ({"tokenizer_training": "joint", "use_ema": True}, "set --policy.use_ema=false"),
        ({"execution": "coherence", "bet_softmax_temperature": 0.0}, "gives a single one"),
        ({"execution": "coherence", "code_hold": "episode"}, "chooses once"),
        ({"pretrained_backbone_weights": "x", "backbone_norm": "group"}, "backbone_norm=frozen_batch"),
    ],
)
def test_what_cannot_work_is_refused_with_the_fix(settings, message):
    with pytest.raises(ConfigurationError, match=message):
        config(**settings)


def test_saved_and_loaded_it_is_the_same(tmp_path):
    made = config(
        input_features={"observation.state": PolicyFeature(FeatureType.STATE, (6,))},
        output_features={"action": PolicyFeature(FeatureType.ACTION, (4,))},
        tokenizer="fsq",
        head_hidden_dims=(8, 9),
    )
    made.save_pretrained(tmp_path)
    assert PreTrainedConfig.from_pretrained(tmp_path) == made
