"""Laplace and Gaussian heads against torch.distributions, and beta-NLL."""

import math

import pytest
import torch
from torch.distributions import Laplace, Normal

from lerobot_act_chunking.heads.action_scale import MAX_SCALE, BoundedScale
from lerobot_act_chunking.heads.gaussian import GaussianHead
from lerobot_act_chunking.heads.laplace import LaplaceHead

B, Q, D, A, S = 3, 5, 16, 4, 2
T = Q * S
N = 20_000
DRAWS = (torch.arange(N) + 0.5) / N


def make(kind, *, beta=0.0, min_std=0.01, temperature=0.0, n_queries=Q, action_dim=A, actions_per_query=S):
    torch.manual_seed(0)
    settings = {"n_queries": n_queries, "beta": beta, "min_std": min_std, "temperature": temperature}
    return kind(D, action_dim, actions_per_query, **settings)


def distribution(head, features):
    location, raw = head.parameters_of(features).unbind(-1)
    kind = Normal if isinstance(head, GaussianHead) else Laplace
    return kind(location, head.scale.log(raw).exp())


@pytest.fixture
def features():
    return torch.randn(B, Q, D, generator=torch.Generator().manual_seed(1))


@pytest.fixture
def actions():
    return torch.randn(B, T, A, generator=torch.Generator().manual_seed(2))


@pytest.mark.parametrize("kind", [GaussianHead, LaplaceHead])
def test_the_loss_is_the_negative_log_likelihood(kind, features, actions):
    head = make(kind)
    expected = -distribution(head, features).log_prob(actions)
    torch.testing.assert_close(head.element_loss(features, actions), expected)


@pytest.mark.parametrize("kind", [GaussianHead, LaplaceHead])
def test_without_temperature_the_most_likely_action(kind, features):
    head = make(kind)
    assert torch.equal(head.actor()(features), distribution(head, features).mean)


@pytest.mark.parametrize("kind", [GaussianHead, LaplaceHead])
@pytest.mark.parametrize("temperature", [0.25, 1.0, 2.0])
def test_samples_have_the_tempered_distribution(kind, temperature, features):
    """p^(1/tau) has a scale of sqrt(tau) sigma or tau b; draws in order are its quantiles."""
    head = make(kind, temperature=temperature, n_queries=1, action_dim=1, actions_per_query=1)
    one = distribution(head, features[:1, :1])
    factor = math.sqrt(temperature) if kind is GaussianHead else temperature
    tempered = type(one)(one.mean, one.scale * factor)
    chunk = head.actor(DRAWS[:, None, None])(features[:1, :1].expand(N, -1, -1))
    torch.testing.assert_close(tempered.cdf(chunk)[:, 0, 0], DRAWS, rtol=0, atol=2e-5)


@pytest.mark.parametrize("kind", [GaussianHead, LaplaceHead])
def test_every_element_has_a_draw_of_its_own(kind, features):
    head = make(kind, temperature=1.0)
    draws = torch.full((B, T, A), 0.5)
    draws[0, 3, 2] = 0.9
    difference = head.actor(draws)(features) - head.actor(torch.full_like(draws, 0.5))(features)
    assert difference.nonzero().tolist() == [[0, 3, 2]]


def mean_gradient(head, features, actions):
    head.zero_grad()
    head.element_loss(features, actions).sum().backward()
    return head.projection.bias.grad.unflatten(0, (S, A, 2))[..., 0].clone()


def test_with_beta_1_the_pull_on_means_is_that_of_the_squared_error(features, actions):
    head = make(GaussianHead, beta=1.0)
    mean = distribution(head, features).mean
    expected = (mean - actions).unflatten(1, (Q, S)).sum((0, 1))
    torch.testing.assert_close(mean_gradient(head, features, actions), expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("beta", [0.0, 0.3, 0.5, 1.0])
def test_beta_weights_the_gradient_by_a_constant(beta, features, actions):
    head = make(GaussianHead, beta=beta)
    normal = distribution(head, features)
    pull = (normal.mean - actions) / normal.scale**2 * normal.scale ** (2 * beta)
    expected = pull.unflatten(1, (Q, S)).sum((0, 1))
    torch.testing.assert_close(mean_gradient(head, features, actions), expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("beta", [0.0, 0.5, 1.0])
def test_at_beta_one_half_locations_are_pulled_as_by_the_absolute_error(beta, features, actions):
    head = make(LaplaceHead, beta=beta)
    laplace = distribution(head, features)
    pull = (laplace.mean - actions).sign() * laplace.scale ** (2 * beta - 1)
    expected = pull.unflatten(1, (Q, S)).sum((0, 1))
    torch.testing.assert_close(mean_gradient(head, features, actions), expected, rtol=1e-4, atol=1e-4)


def test_scales_stay_between_their_bounds_and_have_a_gradient():
    scale = BoundedScale(0.01)
    raw = torch.linspace(-8, 8, 101, dtype=torch.float64, requires_grad=True)
    log = scale.log(raw)
    log.sum().backward()
    assert (log > math.log(0.01)).all()
    assert (log < math.log(MAX_SCALE)).all()
    assert (raw.grad > 0).all()
    assert scale.log(torch.tensor(0.0, dtype=torch.float64)).item() == pytest.approx(0)


@pytest.mark.parametrize("kind", [GaussianHead, LaplaceHead])
def test_the_least_standard_deviation_is_the_one_asked_for(kind, features):
    head = make(kind, min_std=0.05)
    head.projection.bias.data.unflatten(0, (S, A, 2))[..., 1] = -1e3
    stddev = distribution(head, features).stddev
    torch.testing.assert_close(stddev, torch.full_like(stddev, 0.05))
