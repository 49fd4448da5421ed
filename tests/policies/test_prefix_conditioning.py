"""Policies that are given a chunk's first actions go on from them, and without any are as others."""

import pytest
import torch
from lerobot.rollout.inference.rtc import supports_rtc_inference
from policy_cases import CASES, KINDS, STATE, WRAPPED, A, Case, T

from lerobot_act_chunking.errors import ConfigurationError

KINDS_WITH_PREFIX = [kind for kind in KINDS if kind != "diffusion_chunked"]  # which has tests of its own
EVERY = [case for case in CASES if case.type in KINDS_WITH_PREFIX]
OFTEN = {"execution": "receding", "replan_interval": 1}
ids = lambda case: f"{case.type}-{case.name}"  # noqa: E731


def observations(case, batch_size=2):
    return {key: value for key, value in case.batch(batch_size).items() if key.startswith("observation")}


def with_weights_of(case, other, **settings):
    policy = case.policy(**settings)
    missing, unexpected = policy.load_state_dict(other.state_dict(), strict=False)
    assert all("prefix_encoder" in key or "batch_seeds" in key for key in missing)
    assert not unexpected
    return policy


@pytest.mark.parametrize("case", EVERY, ids=ids)
def test_with_nothing_given_it_is_the_policy_without_a_prefix(case):
    plain = case.policy()
    prefixed = with_weights_of(case, plain, prefix_steps=2)
    batch, noise = observations(case), case.noise(2)
    expected = plain.predict_action_chunk(batch, **noise)
    torch.testing.assert_close(prefixed.predict_action_chunk(batch, **noise), expected, rtol=0, atol=0)


@pytest.mark.parametrize("case", EVERY, ids=ids)
def test_a_chunk_continues_what_is_executed_while_it_is_computed(case):
    policy, generator = case.policy(prefix_steps=2, execution="receding"), torch.Generator().manual_seed(2)
    left_over = torch.randn(2, T, A, generator=generator)
    batch, noise = observations(case), case.noise(2)
    alone = policy.predict_action_chunk(batch, **noise)
    chunk = policy.predict_action_chunk(batch, inference_delay=2, prev_chunk_left_over=left_over, **noise)
    assert torch.equal(chunk[:, :2], left_over[:, :2])
    assert chunk.shape == alone.shape


@pytest.mark.parametrize("kind", KINDS_WITH_PREFIX)
def test_what_is_given_decides_where_the_observation_does_not(kind):
    """Demonstrations go up or down, which the observation does not tell, but the first action does."""
    case = Case("ways", kind, STATE, {"prefix_steps": 1, "chunk_size": T})
    policy = case.larger_policy()
    batch = {key: value[:1].repeat(8, *[1] * (value.ndim - 1)) for key, value in case.batch(8).items()}
    way = torch.tensor([1.0, -1.0] * 4)
    batch["action"] = way[:, None, None].expand(8, T, A).contiguous()
    batch["action_is_pad"] = torch.zeros(8, T, dtype=torch.bool)
    if case.kind.sizes.get("n_obs_steps", 1) > 1:
        batch = {k: v[:, None] if k.startswith("observation") else v for k, v in batch.items()}
    policy.train()
    groups = [
        {key: value for key, value in each.items() if key != "fused"} for each in policy.get_optim_params()
    ]
    optimizer = torch.optim.AdamW(groups, lr=3e-3)
    for _ in range(150):
        policy.forward(batch)[0].backward()
        optimizer.step()
        optimizer.zero_grad()
        policy.update()
    one = {key: value[:2] for key, value in batch.items() if key.startswith("observation")}
    told = torch.stack((torch.full((T, A), 1.0), torch.full((T, A), -1.0)))
    chunk = policy.predict_action_chunk(one, inference_delay=1, prev_chunk_left_over=told)
    assert (chunk[0, 1:].mean() - chunk[1, 1:].mean()) > 1


def test_what_is_given_is_not_learned(monkeypatch):
    """Of a network that cannot see what is given, the loss does not depend on it."""
    if "act_chunked" not in KINDS:
        pytest.skip("of one policy type")
    policy = Case("blind", "act_chunked", STATE, {"prefix_steps": 2, "use_vae": False}).policy().train()
    for weight in policy.model.prefix_encoder.parameters():
        torch.nn.init.zeros_(weight)
    monkeypatch.setattr(torch, "randint", lambda high, size, **_: torch.full(size, high - 1))  # all of it
    batch = Case("batch", "act_chunked", STATE).batch()
    batch["action_is_pad"] = torch.zeros_like(batch["action_is_pad"])
    loss = policy.forward(batch)[0]
    batch["action"][:, :2] += 5.0
    assert torch.equal(policy.forward(batch)[0], loss)
    batch["action"][:, 2:] += 5.0
    assert policy.forward(batch)[0] > loss


@pytest.mark.parametrize("case", EVERY, ids=ids)
def test_the_plan_of_its_own_execution_is_continued(case):
    policy = case.policy(prefix_steps=2, execution="receding", latency_steps=2, replan_interval=2)
    batch = observations(case, 1)
    policy.reset()
    seen = []
    policy._action_queue.on_chunk = seen.append
    policy.select_action(batch)
    policy.select_action(batch)
    planned = policy._action_queue.plan()[0][:, :2].clone()
    policy.select_action(batch)
    assert [event.step for event in seen] == [0, 2]
    torch.testing.assert_close(seen[1].chunk[:, :2], planned, rtol=0, atol=1e-6)


@pytest.mark.parametrize("case", [*CASES, *WRAPPED], ids=ids)
def test_every_policy_acts_in_the_real_time_engine(case):
    policy = case.policy(execution="receding")
    assert supports_rtc_inference(policy)
    batch = observations(case, 1)
    left_over = torch.full((1, T, A), 0.5)
    chunk = policy.predict_action_chunk(batch, inference_delay=2, prev_chunk_left_over=left_over)
    free = policy.predict_action_chunk(batch, inference_delay=2, prev_chunk_left_over=None)
    assert chunk.shape == free.shape
    if case.type != "diffusion_chunked":  # which is guided
        assert torch.equal(chunk[:, :2], left_over[:, :2])


@pytest.mark.parametrize("kind", KINDS_WITH_PREFIX)
@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"prefix_steps": T}, "prefix_steps=5 leaves nothing to predict"),
        (
            {"prefix_steps": 1, "latency_steps": 2, "execution": "receding", "replan_interval": 1},
            "latency_steps=2 needs",
        ),
    ],
)
def test_a_prefix_that_cannot_work_is_refused(kind, settings, reason):
    with pytest.raises(ConfigurationError, match=reason):
        Case("refused", kind, STATE).config(**settings)
