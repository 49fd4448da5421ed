"""A tokenizer learns from finite actions alone, and says what keeps it from that."""

import math

import pytest
from lerobot.policies.factory import get_policy_class
from policy_cases import STATE, Case, history_batch

from lerobot_act_chunking.errors import DatasetError

TOO_MUCH = 1e30  # finite, but not its square


def spoiled(policy, key, value):
    batch = history_batch(policy)
    batch[key][1].view(-1)[0] = value
    return batch


TOKENIZERS = [
    ("tokenizer_training", "in_loop", {}),
    ("joint", "joint", {"use_ema": False}),
    ("fsq", "in_loop", {"tokenizer": "fsq"}),
]


@pytest.mark.parametrize(("name", "how", "settings"), TOKENIZERS, ids=[name for name, *_ in TOKENIZERS])
def test_the_tokenizer_does_not_learn_from_what_is_not_finite(name, how, settings):
    config = Case(name, "vqbet_chunked", STATE, {"tokenizer_training": how, **settings}).config()
    policy = get_policy_class("vqbet_chunked")(config).train()
    for value in (math.nan, math.inf):
        with pytest.raises(DatasetError, match="'action' in the batch holds a NaN or an infinity"):
            policy.forward(spoiled(policy, "action", value))
    assert int(policy.tokenizer_phase.n_learned) == 0


def test_an_extreme_action_spoils_the_tokenizer_and_is_named():
    config = Case("state", "vqbet_chunked", STATE).config()
    policy = get_policy_class("vqbet_chunked")(config).train()
    with pytest.raises(DatasetError, match=r"'action' in the batch reaches 1e\+30"):
        policy.forward(spoiled(policy, "action", TOO_MUCH))


def test_a_tokenizer_that_diverges_names_its_own_rate():
    config = Case("state", "vqbet_chunked", STATE).config()
    policy = get_policy_class("vqbet_chunked")(config).train()
    for weight in policy.tokenizer.parameters():
        weight.data.fill_(math.nan)
    with pytest.raises(DatasetError, match=r"lower --policy\.optimizer_vqvae_lr"):
        policy.forward(history_batch(policy))
