"""What each likelihood makes of demonstrations that go two ways, 70 % one and 30 % the other."""

import pytest
import torch
from head_cases import head_spec

from lerobot_act_chunking.heads.make import make_action_head
from lerobot_act_chunking.heads.spec import HeadSize

D, A, Q, S = 16, 4, 5, 2
T = Q * S
SHARE = 0.7
N = 400


@pytest.fixture(scope="module")
def way():
    """The one way (T, A); the other is its negative. No element is near zero."""
    generator = torch.Generator().manual_seed(0)
    return (0.4 + 0.4 * torch.rand(T, A, generator=generator)) * torch.randn(T, A, generator=generator).sign()


@pytest.fixture(scope="module")
def demonstrations(way):
    signs = torch.where(torch.arange(20) < 20 * SHARE, 1.0, -1.0)
    noise = 0.01 * torch.randn(20, T, A, generator=torch.Generator().manual_seed(1))
    return signs[:, None, None] * way + noise


def train(demonstrations, likelihood, *, n_steps=300, idle=(), **settings):
    torch.manual_seed(0)
    spec = head_spec(action_likelihood=likelihood, n_bins=50, min_std=0.02, **settings)
    head = make_action_head(spec, HeadSize(D, A, Q, S))
    for component in idle:
        head.projection.bias.data.unflatten(0, (S, -1, A, 2))[:, component, :, 0] = 3
    features = torch.nn.functional.layer_norm(torch.randn(1, Q, D), (D,))
    is_pad = torch.zeros(len(demonstrations), T, dtype=torch.bool)
    optimizer = torch.optim.Adam(head.parameters(), lr=0.02)
    for _ in range(n_steps):
        optimizer.zero_grad()
        loss = head.loss(features.expand(len(demonstrations), -1, -1), demonstrations, is_pad, "valid")
        loss.mean().backward()
        optimizer.step()
    return head.eval(), features.expand(N, -1, -1)


@torch.no_grad()
def act(head, features):
    generator = torch.Generator().manual_seed(2)
    draws = torch.rand(N, *head.draws_shape, generator=generator) if head.draws_shape else None
    return head.actor(draws)(features)


def off(actions, expected):
    return (actions - expected).abs().max().item()


@pytest.mark.parametrize(
    ("likelihood", "place"), [("l1", 1.0), ("laplace", 1.0), ("l2", 0.4), ("gaussian", 0.4)]
)
def test_one_prediction_is_the_majority_s_way_or_nobody_s(likelihood, place, demonstrations, way):
    """The median is the way of 70 %; the mean 0.7 - 0.3 = 0.4 of it, which no demonstration ever took."""
    head, features = train(demonstrations, likelihood, nll_beta=1.0)
    assert off(act(head, features), place * way) < 0.05


def test_a_gaussian_knows_that_it_does_not_know(demonstrations, way):
    """Its standard deviation is that of both ways together: 2 sqrt(0.7 0.3) of the way."""
    head, features = train(demonstrations, "gaussian", action_temperature=1.0)
    chunks = act(head, features)
    torch.testing.assert_close(chunks.std(0), 2 * (SHARE * 0.3) ** 0.5 * way.abs(), rtol=0.25, atol=0.02)


@pytest.mark.parametrize("n_components", [2, 3, 6])
def test_a_mixture_takes_whole_ways_in_their_shares(n_components, demonstrations, way):
    settings = {"n_components": n_components, "action_temperature": 1.0}
    chunks = act(*train(demonstrations, "gmm", **settings))
    distance = torch.stack([(chunks - sign * way).abs().amax((1, 2)) for sign in (1, -1)])
    assert distance.amin(0).max() < 0.05  # each chunk is one of the ways from its first step to its last
    assert (distance.argmin(0) == 0).float().mean().item() == pytest.approx(SHARE, abs=0.08)


def test_components_far_from_everything_come_back(demonstrations, way, monkeypatch):
    """By likelihood alone a component far off stays there, and the other one blends the ways."""
    chunks = act(*train(demonstrations, "gmm", n_components=2, n_steps=500, idle=[1], action_temperature=1.0))
    assert torch.stack([(chunks - sign * way).abs().amax((1, 2)) for sign in (1, -1)]).amin(0).max() < 0.05
    monkeypatch.setattr("lerobot_act_chunking.heads.mixture.IDLE_WEIGHT", 0.0)
    blended = act(
        *train(demonstrations, "gmm", n_components=2, n_steps=500, idle=[1], action_temperature=1.0)
    )
    assert off(blended, 0.4 * way) < 0.1


def test_bins_keep_both_ways_of_every_element(demonstrations, way):
    """But elements do not agree on one: the head leaves that to a latent or to the decoder."""
    chunks = act(*train(demonstrations, "categorical", action_temperature=1.0))
    ways = chunks / way
    assert ((ways.abs() - 1).abs() < 0.15).float().mean() > 0.99
    assert (ways > 0).float().mean().item() == pytest.approx(SHARE, abs=0.02)
    likeliest = act(*train(demonstrations, "categorical"))
    assert off(likeliest, way) < 0.02
