"""`act_chunked` whose encoder starts from a language model, and reads an instruction."""

import pytest
import torch
from policy_case import ENVIRONMENT, STATE, TOP, B, Case
from tiny_bert import DIM, HEADS, HIDDEN, LAYERS, VOCABULARY, tiny_bert

from lerobot_act_chunking.data.batch import TOKENS, TOKENS_MASK
from lerobot_act_chunking.errors import ConfigurationError, FeatureError

L = 6
SIZES = {"dim_model": DIM, "n_heads": HEADS, "dim_feedforward": HIDDEN, "n_encoder_layers": LAYERS}
BERT = Case(
    "bert", "act_chunked", STATE | ENVIRONMENT, {"encoder_impl": "bert", "encoder_text_tokens": L, **SIZES}
)
READS = {"encoder_vocabulary": VOCABULARY}


def told(batch_size=B):
    tokens = torch.randint(VOCABULARY, (batch_size, L), generator=torch.Generator().manual_seed(0))
    mask = torch.ones(batch_size, L, dtype=torch.bool)
    mask[1:, 4:] = False
    return {TOKENS: tokens, TOKENS_MASK: mask}


@pytest.mark.parametrize("kind", ["bert", "mixer"])
@pytest.mark.parametrize("learning", ["full", "frozen", "lora"])
def test_it_learns_acts_and_comes_back_without_the_language_model(kind, learning, tmp_path):
    tiny_bert(tmp_path / "bert")
    start = {"encoder_init": "language_model", "encoder_weights": str(tmp_path / "bert")}
    start = start if kind == "bert" else {"encoder_impl": kind}
    policy = BERT.policy(encoder_training=learning, use_ema=True, **READS, **start)
    assert all(
        torch.equal(a, b)
        for a, b in zip(policy.model.parameters(), policy.ema.network.parameters(), strict=True)
    )
    before = {name: each.clone() for name, each in policy.model.encoder.named_parameters()}
    policy.train()
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=1e-2)
    policy.forward({**BERT.batch(), **told()})[0].backward()
    optimizer.step()
    policy.update()
    moved = {
        name for name, each in policy.model.encoder.named_parameters() if not torch.equal(each, before[name])
    }
    learns = {name for name, each in policy.model.encoder.named_parameters() if each.requires_grad}
    assert "words.weight" not in learns
    unused = {name for name in learns if name.startswith(f"layers.{LAYERS - 1}.mix.text_out")}
    assert (
        learns - unused <= moved <= learns
    )  # what the mixer's last layer tells the word pieces, nobody reads
    policy.save_pretrained(tmp_path / "policy")
    (tmp_path / "bert" / "model.safetensors").unlink(missing_ok=True)
    back = type(policy).from_pretrained(tmp_path / "policy")
    frame = {**BERT.batch(), **told()}
    chunk = policy.predict_action_chunk(frame)
    assert torch.equal(back.predict_action_chunk(frame), chunk)
    policy.reset()
    assert torch.allclose(policy.select_action(frame), chunk[:, 0], atol=1e-6)
    other = {**frame, TOKENS: (frame[TOKENS] + 1) % VOCABULARY}
    assert not torch.allclose(back.predict_action_chunk(other), chunk)


def test_the_body_learns_at_its_own_rate():
    policy = BERT.policy(optimizer_lr=1e-3, optimizer_lr_encoder=1e-5, **READS)
    rates = {
        parameter: group.get("lr", 1e-3)
        for group in policy.get_optim_params()
        for parameter in group["params"]
    }
    names = {name: rates[each] for name, each in policy.model.named_parameters() if each in rates}
    assert names["encoder.layers.0.mix.attention.q_proj.weight"] == 1e-5
    assert names["encoder.robot_norm.weight"] == names["style_token"] == 1e-3


def test_a_history_keeps_the_current_instruction():
    case = Case("history", "act_chunked", STATE, {**BERT.settings, "n_obs_steps": 2, **READS})
    policy = case.policy()
    frame = {"observation.state": case.batch()["observation.state"], **told()}
    policy.select_action(frame)
    policy.reset()
    one = policy.select_action(frame)
    policy.reset()
    other = policy.select_action({**frame, TOKENS: (frame[TOKENS] + 1) % VOCABULARY})
    assert not torch.allclose(one, other)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({TOKENS: None}, "the batch has no 'observation.language.tokens'"),
        ({TOKENS_MASK: torch.ones(B, L + 1)}, "was built for"),
        (
            {TOKENS: torch.ones(B, L + 2, dtype=torch.int64), TOKENS_MASK: torch.ones(B, L + 2)},
            f"has {L + 2} tokens, more than encoder_text_tokens={L}",
        ),
    ],
)
def test_what_is_no_instruction_is_refused(change, message):
    with pytest.raises(FeatureError, match=message):
        BERT.policy(**READS).forward({**BERT.batch(), **told(), **change})


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"encoder_impl": "act", "encoder_init": "permuted"}, "is of language models"),
        ({"encoder_impl": "act", "encoder_vocabulary": 3}, "is of language models"),
        ({"encoder_weights": "x"}, "has no use with encoder_init=random"),
        ({"encoder_impl": "mixer", "encoder_init": "language_model"}, "give --policy.encoder_weights"),
        ({"encoder_init": "only_embeddings"}, "the encoder reads none"),
    ],
)
def test_settings_that_contradict_each_other_are_refused(settings, message):
    with pytest.raises(ConfigurationError, match=message):
        BERT.config(**settings)


def test_the_mixer_needs_a_place_for_each_token():
    case = Case("cells", "act_chunked", STATE | TOP, {**BERT.settings, "encoder_impl": "mixer"})
    with pytest.raises(ConfigurationError, match=r"set --policy\.image_tokens=summary"):
        case.policy()


def test_the_sizes_are_minilms_unless_given():
    case = Case("sizes", "act_chunked", STATE, {"encoder_impl": "bert"})
    config = case.config(dim_model=None, n_heads=None, dim_feedforward=None, n_encoder_layers=None)
    sizes = (config.dim_model, config.n_heads, config.dim_feedforward, config.n_encoder_layers)
    assert sizes == (384, 12, 1536, 6)
