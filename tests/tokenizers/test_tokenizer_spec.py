"""Settings of tokenizers: what is refused, and how they travel."""

import json
from dataclasses import asdict, replace
from types import SimpleNamespace

import pytest
from tokenizer_cases import SMALL, A, C, small, spec

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.tokenizers.coders import make_coders
from lerobot_act_chunking.tokenizers.make import (
    TOKENIZERS,
    building_settings,
    check_tokenizer,
    make_tokenizer,
)
from lerobot_act_chunking.tokenizers.spec import TokenizerSpec

REFUSED = [
    ({"tokenizer": "bpe"}, "unknown tokenizer 'bpe'; choose one of: residual_vq, fsq, uniform, dct"),
    ({"chunk_size": 0}, "chunk_size=0 must be at least 1"),
    ({"action_dim": 0}, "action_dim=0 must be at least 1"),
    ({"vqvae_coder": "rnn"}, "unknown vqvae_coder 'rnn'; choose one of: mlp, conv"),
    ({"vqvae_num_layers": 0}, "vqvae_num_layers=0 must be at least 1"),
    ({"vqvae_embedding_dim": 0}, "vqvae_embedding_dim=0 must be at least 1"),
    ({"vqvae_enc_hidden_dim": 0}, "vqvae_enc_hidden_dim=0 must be at least 1"),
    ({"vqvae_n_embed": 1}, "vqvae_n_embed=1 must be at least 2"),
    ({"kmeans_iters": -1}, "kmeans_iters=-1 must be at least 0"),
    ({"dead_code_threshold": -0.5}, "dead_code_threshold=-0.5 must be at least 0"),
    ({"dead_code_threshold": float("inf")}, "dead_code_threshold=inf must be at least 0 and at most 100"),
    ({"commitment_weight": float("nan")}, "commitment_weight=nan must be at least 0 and at most"),
    ({"vqvae_decay": 1.0}, r"vqvae_decay=1.0 must be at least 0 and below 1: the share"),
    ({"vqvae_decay": -0.1}, r"vqvae_decay=-0.1 must be at least 0 and below 1"),
    (
        {"rotation_trick": True, "vqvae_embedding_dim": 1},
        "rotation_trick needs a direction to turn, and vqvae_embedding_dim=1 has none: use more dimensions",
    ),
    ({"tokenizer": "fsq", "fsq_levels": ()}, r"fsq_levels=\(\) must name at least one dimension"),
    ({"tokenizer": "fsq", "fsq_levels": (4, 1)}, r"fsq_levels=\(4, 1\) must name .* such as \(8, 5, 5\)"),
    ({"tokenizer": "uniform", "n_bins": 1}, "n_bins=1 must be at least 2"),
    ({"tokenizer": "dct", "n_bins": 0}, "n_bins=0 must be at least 2"),
    (
        {"tokenizer": "dct", "dct_coefficients": 8},
        "dct_coefficients=8 must be at least 1 and at most chunk_size=7",
    ),
    ({"tokenizer": "dct", "dct_coefficients": 0}, "dct_coefficients=0 must be at least 1"),
]


@pytest.mark.parametrize(("values", "message"), REFUSED)
def test_what_cannot_work_is_refused(values, message):
    with pytest.raises(ConfigurationError, match=message):
        make_tokenizer(replace(spec(), **values))


def test_another_coder_is_refused():
    with pytest.raises(ConfigurationError, match="unknown vqvae_coder 'rnn'; choose one of: mlp, conv"):
        make_coders("rnn", C, A, dim=2, hidden_dim=2)


@pytest.mark.parametrize("tokenizer", TOKENIZERS)
def test_settings_of_other_tokenizers_do_not_count(tokenizer):
    own = {"fsq": {"vqvae_n_embed": 0}, "residual_vq": {"fsq_levels": ()}}.get(
        tokenizer, {"vqvae_coder": "rnn"}
    )
    check_tokenizer(spec(tokenizer, **own))


@pytest.mark.parametrize("tokenizer", TOKENIZERS)
def test_a_spec_travels_through_json(tokenizer):
    original = spec(tokenizer)
    assert TokenizerSpec.from_values(json.loads(json.dumps(asdict(original)))) == original


def test_a_spec_from_a_policys_fields():
    values = {
        name: value for name, value in asdict(spec("fsq")).items() if name not in ("chunk_size", "action_dim")
    }
    config = SimpleNamespace(**values | {"fsq_levels": [3, 4], "gpt_n_layer": 2})
    assert TokenizerSpec.from_fields(config, chunk_size=C, action_dim=A) == spec("fsq")


@pytest.mark.parametrize("tokenizer", TOKENIZERS)
def test_what_a_tokenizer_is_rebuilt_from(tokenizer):
    original = small(tokenizer)
    settings = building_settings(spec(tokenizer))
    assert settings["tokenizer"] == tokenizer
    others = {"vqvae_n_embed": 3, "vqvae_num_layers": 1, "fsq_levels": (2,), "n_bins": 3}
    rebuilt = make_tokenizer(spec(**others | settings))
    assert (rebuilt.n_codes, rebuilt.vocabulary) == (original.n_codes, original.vocabulary)
    rebuilt.load_state_dict(original.state_dict(), strict=True)


def test_sizes_of_codes():
    expected = {"residual_vq": (2, 5), "fsq": (2, 12), "uniform": (C * A, 9), "dct": (4 * A, 9)}
    assert {name: (small(name).n_codes, small(name).vocabulary) for name in expected} == expected
    assert SMALL["n_bins"] == 9
