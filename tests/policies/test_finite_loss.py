"""Property: training never goes on with a loss that is not finite, and says which input made it so."""

import math

import pytest
import torch
from policy_cases import CASES, history_batch, of_every_type
from tiers import some

from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.policies.finite_loss import finite_terms


def spoiled(policy, key, value):
    batch = history_batch(policy)
    batch[key][1].view(-1)[0] = value
    return batch


@pytest.mark.parametrize("training", [True, False], ids=["training", "evaluation"])
@pytest.mark.parametrize(
    "case", some(8, CASES, by=lambda case: case.type), ids=lambda case: f"{case.type}-{case.name}"
)
def test_every_input_that_spoils_the_loss_is_named(case, training):
    all_read = {"condition_dropout": 0.0, "guidance_scale": 1.0} if case.type == "diffusion_chunked" else {}
    policy = case.policy(**all_read).train(training)
    assert torch.isfinite(policy.forward(history_batch(policy))[0])
    for key in policy.feature_spec.keys:
        for value in (math.nan, math.inf, -math.inf):
            with pytest.raises(DatasetError, match=f"'{key}' in the batch holds a NaN or an infinity"):
                policy.forward(spoiled(policy, key, value))


@pytest.mark.parametrize(
    ("case", "weight"), of_every_type("WEIGHTED"), ids=lambda each: getattr(each, "type", each)
)
def test_terms_may_be_finite_and_their_sum_not(case, weight):
    policy = case.policy().train()
    setattr(policy.config, weight, 1e39)
    with pytest.raises(DatasetError, match="the loss is not finite"):
        policy.forward(history_batch(policy))


def test_an_extreme_input_is_named_before_the_weights():
    batch = {"action": torch.ones(2, 3), "observation.state": torch.tensor([[1.0, -2e7], [3.0, 4.0]])}
    with pytest.raises(DatasetError, match=r"'observation\.state' in the batch reaches 2e\+07"):
        finite_terms(torch.tensor(math.inf), {"l1_loss": math.inf}, batch, batch)


def test_what_was_not_read_is_not_to_blame():
    batch = {"action": torch.ones(2, 3), "next.reward": torch.tensor([math.nan, 1.0])}
    with pytest.raises(DatasetError, match=r"all inputs are finite: .* lower --policy\.optimizer_lr"):
        finite_terms(torch.tensor(math.nan), {}, batch, ["action"])
    terms = {"l1_loss": torch.tensor(1.5), "commitment": 0.5}
    assert finite_terms(torch.tensor([1.0, 2.0]), terms, batch, ["action"]) == {
        "l1_loss": 1.5,
        "commitment": 0.5,
    }
