import math

import pytest
import torch
import torch.nn.functional as F  # noqa: N812

from lerobot_act_chunking.heads.categorical import CategoricalHead
from lerobot_act_chunking.heads.categorical_bins import (
    bin_limit,
    cross_entropy,
    soft_local,
    soft_targets,
    tail_bins,
)

B, Q, D, A, S, M = 3, 5, 16, 4, 2, 24
T = Q * S
SIGMA = 0.75
LIMIT = bin_limit(M, SIGMA)
WIDTH = 2 * LIMIT / M
CENTRES = (torch.arange(M) + 0.5) * WIDTH - LIMIT


def make(*, sigma=SIGMA, soft_local_bins=0, temperature=0.0, top_k=0, n_bins=M):
    torch.manual_seed(0)
    return CategoricalHead(
        D,
        A,
        S,
        n_queries=Q,
        n_bins=n_bins,
        sigma=sigma,
        soft_local_bins=soft_local_bins,
        temperature=temperature,
        top_k=top_k,
    )


def dense(actions, n_bins, sigma):
    """Soft targets over all bins, by the formula."""
    bins, mass = soft_targets(actions, n_bins, sigma)
    return torch.zeros(*actions.shape, n_bins, dtype=mass.dtype).scatter_add(-1, bins, mass)


def grid(n=4001):
    return torch.linspace(-1, 1, n, dtype=torch.float64)


@pytest.mark.parametrize("sigma", [0.0, 0.3, SIGMA, 2.0])
def test_targets_are_probabilities(sigma):
    target = dense(grid(), M, sigma)
    assert (target >= 0).all()
    torch.testing.assert_close(target.sum(-1), torch.ones(len(grid()), dtype=torch.float64))


@pytest.mark.parametrize("sigma", [0.3, SIGMA, 2.0])
def test_targets_are_the_normal_s_mass_in_each_bin(sigma):
    actions, limit = grid(), bin_limit(M, sigma)
    normal = torch.distributions.Normal(actions[:, None], sigma * 2 * limit / M)
    expected = normal.cdf(torch.linspace(-limit, limit, M + 1, dtype=torch.float64)).diff(dim=-1)
    torch.testing.assert_close(dense(actions, M, sigma), expected, rtol=0, atol=1e-5)


def test_without_spread_bins_cover_the_actions_and_the_own_gets_all():
    centres = (torch.arange(M) + 0.5) * 2 / M - 1
    torch.testing.assert_close(dense(centres, M, 0.0), torch.eye(M))


@pytest.mark.parametrize("sigma", [0.0, SIGMA])
def test_actions_outside_count_as_at_the_ends(sigma):
    far = torch.tensor([-7.0, 7.0])
    assert torch.equal(dense(far, M, sigma), dense(far.sign(), M, sigma))
    inner = tail_bins(sigma)
    assert dense(far, M, sigma)[0, :inner].sum() == pytest.approx(0.5 * (sigma > 0), abs=1e-4)


@pytest.mark.parametrize("sigma", [0.0, SIGMA])
def test_cross_entropy_is_that_of_the_dense_targets(sigma):
    generator = torch.Generator().manual_seed(0)
    logits = torch.randn(B, T, A, M, generator=generator)
    actions = torch.rand(B, T, A, generator=generator) * 2 - 1
    expected = F.cross_entropy(
        logits.flatten(0, 2), dense(actions, M, sigma).flatten(0, 2), reduction="none"
    ).unflatten(0, (B, T, A))
    torch.testing.assert_close(cross_entropy(logits, *soft_targets(actions, M, sigma)), expected)


def test_the_head_descends_exactly_this():
    head = make()
    features = torch.randn(B, Q, D)
    actions = torch.rand(B, T, A) * 2 - 1
    expected = cross_entropy(head.parameters_of(features), *soft_targets(actions, M, SIGMA))
    assert torch.equal(head.element_loss(features, actions), expected)


@pytest.mark.parametrize("sigma", [0.0, SIGMA])
def test_the_centre_of_the_likeliest_bin_is_at_most_half_a_bin_off(sigma):
    logits, limit = dense(grid(), M, sigma).log(), bin_limit(M, sigma)
    error = (soft_local(logits, logits.argmax(-1), 0, limit) - grid()).abs() * M / (2 * limit)  # in bins
    assert 0.49 < error.max() < 0.5 + 1e-6


def test_expecting_within_some_bins_brings_back_what_lies_between_centres():
    """Everywhere, the ends included."""
    logits = dense(grid(), M, SIGMA).log()
    error = soft_local(logits, logits.argmax(-1), 2, LIMIT) - grid()
    assert error.abs().max() < 0.03 * WIDTH


def test_expectations_stay_within_reach():
    logits = torch.randn(1000, M, generator=torch.Generator().manual_seed(0)) * 5
    bins = torch.arange(1000) % M
    for reach in (0, 1, 2, 20):
        chosen = soft_local(logits, bins, reach, LIMIT)
        assert ((chosen - CENTRES[bins]).abs() <= reach * WIDTH + 1e-6).all()
    torch.testing.assert_close(soft_local(logits, bins, M, LIMIT), logits.softmax(-1) @ CENTRES)


def sample_counts(head, logits, n, seed=0):
    """How often each bin is chosen by a head whose logits are these, whatever it sees."""
    head.projection.weight.data.zero_()
    head.projection.bias.data[:] = logits.repeat(S * A)
    generator = torch.Generator().manual_seed(seed)
    n_chunks = n // (T * A)
    draws = torch.rand(n_chunks, T, A, generator=generator)
    chunk = head.actor(draws)(torch.randn(n_chunks, Q, D, generator=generator))
    bins = ((chunk + LIMIT) / WIDTH).floor().long()
    return torch.bincount(bins.flatten(), minlength=M), n_chunks * T * A


def chi_square(counts, probabilities, n):
    there = probabilities > 0
    assert not counts[~there].any()
    return ((counts - n * probabilities)[there].square() / (n * probabilities[there])).sum().item()


@pytest.mark.parametrize("temperature", [0.5, 1.0, 2.0])
def test_samples_have_the_probabilities(temperature):
    logits = torch.randn(M, generator=torch.Generator().manual_seed(3))
    counts, n = sample_counts(make(temperature=temperature), logits, 40_000)
    assert chi_square(counts, (logits / temperature).softmax(-1), n) < 49.7  # 1 in 1000, 23 degrees


@pytest.mark.parametrize("top_k", [1, 3, M])
def test_only_the_likeliest_are_sampled(top_k):
    logits = torch.randn(M, generator=torch.Generator().manual_seed(3))
    counts, n = sample_counts(make(temperature=1.0, top_k=top_k), logits, 40_000)
    kept = logits.masked_fill(logits < logits.sort().values[-top_k], -math.inf)
    assert (counts > 0).sum() == top_k
    assert chi_square(counts, kept.softmax(-1), n) < 49.7


def test_without_temperature_the_likeliest_bin():
    head = make()
    features = torch.randn(B, Q, D)
    torch.testing.assert_close(head.actor()(features), CENTRES[head.parameters_of(features).argmax(-1)])


def test_a_cold_sample_is_the_likeliest():
    features = torch.randn(B, Q, D)
    torch.testing.assert_close(
        make(temperature=1e-6).actor(torch.rand(B, T, A))(features), make().actor()(features)
    )


def test_samples_are_refined_around_their_own_bin():
    """Two far modes: the expectation within two bins never lies between them."""
    head = make(temperature=1.0, soft_local_bins=2)
    head.projection.weight.data.zero_()
    logits = torch.full((M,), -20.0)
    logits[[1, M - 2]] = 0
    head.projection.bias.data[:] = logits.repeat(S * A)
    chunk = head.actor(torch.rand(B, T, A))(torch.randn(B, Q, D))
    torch.testing.assert_close(chunk.abs(), torch.full_like(chunk, CENTRES[-2].item()))
    assert (chunk > 0).any()
    assert (chunk < 0).any()
