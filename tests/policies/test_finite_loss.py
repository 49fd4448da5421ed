"""Property: training never goes on with a loss that is not finite, and says which input made it so."""

import math

import pytest
import torch
from lerobot.policies.factory import get_policy_class
from policy_cases import CASES, STATE, Case, history_batch

from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.policies.finite_loss import require_finite_loss

TOO_MUCH = 1e30  # finite, but not its square


def spoiled(policy, key, value):
    batch = history_batch(policy)
    batch[key][1].view(-1)[0] = value
    return batch


@pytest.mark.parametrize("training", [True, False], ids=["training", "evaluation"])
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.type}-{case.name}")
def test_every_input_that_spoils_the_loss_is_named(case, training):
    all_read = {"condition_dropout": 0.0, "guidance_scale": 1.0} if case.type == "diffusion_chunked" else {}
    policy = case.policy(**all_read).train(training)
    assert torch.isfinite(policy.forward(history_batch(policy))[0])
    for key in policy.feature_spec.keys:
        for value in (math.nan, math.inf, -math.inf):
            with pytest.raises(DatasetError, match=f"'{key}' in the batch holds a NaN or an infinity"):
                policy.forward(spoiled(policy, key, value))


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


@pytest.mark.parametrize(
    ("policy_type", "weight"),
    [("vqbet_chunked", "offset_loss_weight"), ("act_chunked", "kl_weight")],
)
def test_terms_may_be_finite_and_their_sum_not(policy_type, weight):
    settings = {"use_vae": True} if policy_type == "act_chunked" else {}
    policy = Case("state", policy_type, STATE, settings).policy().train()
    setattr(policy.config, weight, 1e39)
    with pytest.raises(DatasetError, match="the loss is not finite"):
        policy.forward(history_batch(policy))


def test_an_extreme_input_is_named_before_the_weights():
    batch = {"action": torch.ones(2, 3), "observation.state": torch.tensor([[1.0, -2e7], [3.0, 4.0]])}
    with pytest.raises(DatasetError, match=r"'observation\.state' in the batch reaches 2e\+07"):
        require_finite_loss(torch.tensor(math.inf), {"l1_loss": math.inf}, batch, batch)


def test_what_was_not_read_is_not_to_blame():
    batch = {"action": torch.ones(2, 3), "next.reward": torch.tensor([math.nan, 1.0])}
    with pytest.raises(DatasetError, match=r"all inputs are finite: .* lower --policy\.optimizer_lr"):
        require_finite_loss(torch.tensor(math.nan), {}, batch, ["action"])
    require_finite_loss(torch.tensor([1.0, 2.0]), {"l1_loss": 1.5}, batch, ["action"])
