"""Tokenizer files: what they hold, and policies that they do not fit."""

import json
from dataclasses import asdict, fields, replace

import pytest
import torch
from lerobot.configs import NormalizationMode
from safetensors.torch import save_file

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked import VqbetChunkedConfig
from lerobot_act_chunking.policies.vqbet_chunked.tokenizer_file import (
    HEADER,
    TokenizerInfo,
    TokenizerTraining,
    check_fits,
    check_normalization,
    load_tokenizer,
    read_info,
    save_tokenizer,
)
from lerobot_act_chunking.tokenizers.make import make_tokenizer
from lerobot_act_chunking.tokenizers.spec import TokenizerSpec

SMALL = {"vqvae_n_embed": 4, "vqvae_embedding_dim": 6, "vqvae_enc_hidden_dim": 8}
SPEC = TokenizerSpec.from_fields(VqbetChunkedConfig(device="cpu", **SMALL), chunk_size=5, action_dim=3)
STATISTICS = {"mean": [0.0, 1.0, -2.0], "std": [1.0, 0.01, 0.3]}
INFO = TokenizerInfo(
    spec=SPEC,
    chunk_stride=2,
    normalization="MEAN_STD",
    norm_std_floor=0.01,
    statistics=STATISTICS,
    dataset="demos",
    n_frames=40,
    training=TokenizerTraining(steps=3),
)


@pytest.fixture
def file(tmp_path):
    torch.manual_seed(0)
    tokenizer = make_tokenizer(SPEC)
    tokenizer.learn(torch.randn(20, 5, 3), torch.zeros(20, 5, dtype=torch.bool), 0)
    save_tokenizer(tmp_path / "t.safetensors", tokenizer, INFO)
    return tmp_path / "t.safetensors", tokenizer


def test_codes_survive_a_file(file):
    path, tokenizer = file
    spec, info, weights = load_tokenizer(path)
    assert (spec, info) == (SPEC, INFO)
    torch.manual_seed(1)
    restored = make_tokenizer(spec)
    restored.load_state_dict(weights)
    actions = torch.randn(50, 5, 3)
    codes = tokenizer.encode(actions)
    assert len(codes.unique(dim=0)) > 1
    assert torch.equal(restored.encode(actions), codes)
    assert torch.equal(restored.decode(codes), tokenizer.decode(codes))


def test_the_names_in_files_stay():
    content = json.loads(INFO.to_json())
    assert content["lessons"] == asdict(INFO.training)
    assert set(content) == {field.name for field in fields(INFO)} - {"training"} | {"lessons"}
    assert TokenizerInfo.from_json(INFO.to_json()) == INFO


def test_what_a_file_says_needs_no_weights(file):
    path, _ = file
    whole = path.read_bytes()
    header = int.from_bytes(whole[:8], "little") + 8
    path.write_bytes(whole[:header] + bytes(len(whole) - header))
    assert read_info(path) == INFO


def test_fields_of_a_policy_that_follow_from_a_file():
    assert INFO.policy_fields == {
        "tokenizer": "residual_vq",
        "chunk_size": 5,
        "vqvae_n_embed": 4,
        "vqvae_num_layers": 2,
        "vqvae_embedding_dim": 6,
        "vqvae_enc_hidden_dim": 8,
        "vqvae_coder": "mlp",
        "chunk_stride": 2,
        "norm_std_floor": 0.01,
    }


def test_absent_and_foreign_files(tmp_path):
    with pytest.raises(
        ConfigurationError, match=r"there is no tokenizer at .*none: make one with act-chunking tr"
    ):
        read_info(tmp_path / "none")
    with pytest.raises(ConfigurationError, match="there is no tokenizer"):
        load_tokenizer(tmp_path)
    save_file({"weight": torch.zeros(2)}, tmp_path / "other.safetensors")
    (tmp_path / "text").write_text("hello")
    for name in ("other.safetensors", "text"):
        with pytest.raises(ConfigurationError, match=f"{name} is not a file of act-chunking train-tokenizer"):
            read_info(tmp_path / name)


@pytest.mark.parametrize("header", ["", "not JSON", "[" * 100_000, "[1]", "{}"])
def test_a_damaged_header_is_no_tokenizers(header, tmp_path):
    save_file({"weight": torch.zeros(2)}, tmp_path / "damaged.safetensors", {HEADER: header})
    with pytest.raises(ConfigurationError, match="is not a file of act-chunking train-tokenizer"):
        read_info(tmp_path / "damaged.safetensors")


def test_a_policy_of_the_same_chunks_fits():
    check_fits(INFO, SPEC, chunk_stride=2)
    check_fits(INFO, replace(SPEC, vqvae_decay=0.5, kmeans_iters=0, rotation_trick=False), chunk_stride=2)


@pytest.mark.parametrize(
    ("other", "stride", "message"),
    [
        (
            {"chunk_size": 6},
            2,
            "the tokenizer file has chunk_size=5, the policy chunk_size=6: leave out --policy",
        ),
        (
            {"vqvae_n_embed": 9},
            2,
            "has vqvae_n_embed=4, the policy vqvae_n_embed=9: .* train a tokenizer with vq",
        ),
        ({"tokenizer": "fsq"}, 2, "has tokenizer=residual_vq, the policy tokenizer=fsq"),
        ({}, 1, "has chunk_stride=2, the policy chunk_stride=1"),
        (
            {"action_dim": 4},
            2,
            "has action_dim=3, the policy action_dim=4: train a tokenizer for these actions",
        ),
    ],
)
def test_a_policy_of_other_chunks_does_not_fit(other, stride, message):
    with pytest.raises(ConfigurationError, match=message):
        check_fits(INFO, replace(SPEC, **other), stride)


def test_equal_statistics_fit_whatever_they_are_stored_as():
    stats = {"mean": torch.tensor([0.0, 1.0, -2.0 + 1e-6]), "std": [1.0, 0.01, 0.3], "max": [9.0]}
    check_normalization(INFO, NormalizationMode.MEAN_STD, stats)
    check_normalization(INFO, "MEAN_STD", None)


def test_another_normalisation_is_refused():
    with pytest.raises(
        ConfigurationError, match=r"has learned actions normalised by MEAN_STD, the policy .* MIN_MAX"
    ):
        check_normalization(INFO, "MIN_MAX", None)
    for name, values in (("mean", [0.0, 1.1, -2.0]), ("std", [1.0, 0.011, 0.3])):
        message = rf"trained on demos \(norm_std_floor=0.01\), where '{name}' of action 1 is .*: train"
        with pytest.raises(ConfigurationError, match=message):
            check_normalization(INFO, "MEAN_STD", {**STATISTICS, name: values})
