"""Policies that sample: episodes draw anew, runs repeat, and known seeds decide at any batch size."""

import pytest
import torch
from policy_cases import A, of_every_type
from tiers import some

SAMPLING = some(7, of_every_type("SAMPLING"), by=lambda case: case.type)
N_EPISODES, STEPS = 3, 7


@pytest.fixture(params=SAMPLING, ids=lambda case: f"{case.type}-{case.name}")
def case(request):
    return request.param


def batch_of(case, n):
    """The same observation in every environment: what differs between them is drawn."""
    one = {key: value for key, value in case.batch(1).items() if key.startswith("observation")}
    return {key: value.repeat(n, *[1] * (value.ndim - 1)) for key, value in one.items()}


def episode(policy, case, n, **reset):
    policy.reset(**reset)
    return torch.stack([policy.select_action(batch_of(case, n)) for _ in range(STEPS)], dim=1)


def test_episodes_and_environments_draw_anew_and_runs_repeat(case):
    policy, again = case.policy(), case.policy()
    first, second = ([episode(each, case, 2) for _ in range(N_EPISODES)] for each in (policy, again))
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))
    rows = torch.cat(first).flatten(1)
    assert rows.shape == (2 * N_EPISODES, STEPS * A)
    expected = 2 if case.type == "vqbet_chunked" else len(rows)  # codes are few: two draws may pick the same
    assert len(rows.unique(dim=0)) >= expected


def test_a_known_seed_decides_whatever_runs_beside_it(case):
    policy = case.policy()
    together = episode(policy, case, 3, episode_seeds=[1000, 1001, 1002])
    alone = torch.cat([episode(policy, case, 1, episode_seeds=[seed]) for seed in (1000, 1001, 1002)])
    torch.testing.assert_close(together, alone, rtol=1e-4, atol=1e-5)


def test_an_environment_that_starts_alone_draws_anew(case):
    policy, undisturbed = case.policy(), case.policy()
    batch = batch_of(case, 2)
    before = policy.select_action(batch)
    undisturbed.select_action(batch)
    policy.reset([1])
    after, expected = policy.select_action(batch), undisturbed.select_action(batch)
    assert torch.equal(after[0], expected[0])
    assert not torch.equal(after[1], before[1])


def test_another_noise_seed_draws_otherwise(case):
    if case.type == "temporal_ensemble":
        return
    one, other = (episode(case.policy(noise_seed=seed), case, 1, episode_seeds=[5]) for seed in (0, 1))
    assert not torch.equal(one, other)
