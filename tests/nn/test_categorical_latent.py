"""The latent of codes."""

import pytest
import torch
from latent_cases import MANY, B, M, posterior_of, rng, tokens
from torch.distributions import Categorical, kl_divergence

from lerobot_act_chunking.nn.latents.categorical import CategoricalLatent
from lerobot_act_chunking.nn.latents.normal import select_component


def test_codes_are_one_hot_with_the_relaxations_gradient():
    latent = CategoricalLatent(M, anneal_steps=1)
    posterior_of(latent)
    parameters = 0.1 * torch.randn(B, M, generator=rng())
    noise = torch.randn(B, M, generator=rng(1))
    z = latent.posterior(parameters.requires_grad_(), noise, tokens()).z
    assert z.detach().sort(-1).values.round(decimals=5).tolist() == [[0.0] * (M - 1) + [1.0]] * B
    gumbel = -(-torch.special.ndtr(noise.double()).log()).log()
    relaxed = ((10 * parameters.double()).log_softmax(-1) + gumbel).div(0.3).softmax(-1)
    weights = torch.arange(float(M))
    (expected,) = torch.autograd.grad((relaxed * weights).sum(), parameters)
    (found,) = torch.autograd.grad((z * weights).sum(), parameters)
    torch.testing.assert_close(found, expected, atol=1e-3, rtol=1e-3)


def test_codes_are_sampled_by_their_probability():
    latent = CategoricalLatent(M, anneal_steps=1)
    parameters = 0.1 * torch.randn(1, M, generator=rng())
    noise = torch.randn(MANY, M, generator=rng(1))
    posterior = latent.posterior(parameters.expand(MANY, -1), noise, tokens(MANY))
    torch.testing.assert_close(posterior.z.mean(0), posterior.mean[0], atol=0.015, rtol=0)


def test_the_divergence_of_codes_is_torchs():
    latent = CategoricalLatent(M, anneal_steps=1)
    parameters = 0.2 * torch.randn(B, M, generator=rng())
    posterior = latent.posterior(parameters, torch.zeros(B, M), tokens())
    q = Categorical(probs=posterior.mean)
    expected = kl_divergence(q, Categorical(logits=torch.zeros(B, M)))
    torch.testing.assert_close(posterior.divergence[:, 0], expected)


def test_the_relaxation_hardens_in_training_alone():
    latent, temperatures = CategoricalLatent(M, anneal_steps=2), []
    for step in range(4):
        latent.train(step != 1)
        temperatures.append(latent.relaxation.item())
        posterior_of(latent)
    assert temperatures == pytest.approx([1.0, 0.65, 0.65, 0.3])


def used_codes(**settings):
    """Codes 1, 2 and 4 in use, as training has seen."""
    latent = CategoricalLatent(M, anneal_steps=1, **settings)
    logits = torch.full((20, M), -5.0)
    logits[torch.arange(20), torch.tensor([1] * 14 + [2] * 4 + [4] * 2)] = 5.0
    for _ in range(1000):
        latent.posterior(logits, torch.zeros(20, M), tokens(20))
    return latent.eval()


@pytest.mark.parametrize(
    ("settings", "shares"),
    [
        ({}, [0, 0.7, 0.2, 0, 0.1, 0]),
        ({"uniform": True}, [0, 1 / 3, 1 / 3, 0, 1 / 3, 0]),
        ({"temperature": 0.5}, [0, 0.49 / 0.54, 0.04 / 0.54, 0, 0.01 / 0.54, 0]),
    ],
    ids=["empirical", "uniform", "cold"],
)
def test_only_used_codes_are_sampled(settings, shares):
    latent = used_codes(**settings)
    z = latent.prior(torch.randn(MANY, M, generator=rng()), tokens(MANY))
    torch.testing.assert_close(z.mean(0), torch.tensor(shares, dtype=z.dtype), atol=0.015, rtol=0)
    assert not z[:, [0, 3, 5]].any()
    assert latent.prior(None, tokens()).argmax(-1).tolist() == [1] * B


def test_a_choice_without_weight_is_never_made():
    weights = torch.tensor([0.0, 0.3, 0.0, 0.7, 0.0])
    extremes = select_component(weights, torch.tensor([-9.0, -40.0, 9.0, 40.0]))
    assert extremes.argmax(-1).tolist() == [1, 1, 3, 3]
