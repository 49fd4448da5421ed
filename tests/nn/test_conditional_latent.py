"""The latent whose prior follows the observation."""

import torch
from latent_cases import B, L, make, rng, tokens
from torch.distributions import Normal, kl_divergence


def test_a_conditional_prior_starts_standard_and_follows_the_observation():
    latent = make("conditional", z_temperature=0.5)
    noise = torch.randn(B, L, generator=rng())
    torch.testing.assert_close(latent.prior(noise, tokens()), 0.5 * noise)
    torch.nn.init.normal_(latent.predict[-1].weight)
    modes = latent.prior(None, tokens())
    assert not torch.allclose(modes[0], modes[1])
    shuffled = tokens().flip(1)  # a set of tokens, not a sequence
    torch.testing.assert_close(latent.prior(None, shuffled), modes)
    spread = latent.prior(noise, tokens()) - modes
    torch.testing.assert_close(latent.prior(2 * noise, tokens()) - modes, 2 * spread)


def test_a_conditional_divergence_is_that_from_its_prior():
    latent = make("conditional")
    torch.nn.init.normal_(latent.predict[-1].weight, std=0.3)
    mean, deviation = latent.prior(None, tokens()), latent.prior(torch.ones(B, L), tokens())
    prior = Normal(mean, deviation - mean)
    parameters = torch.randn(B, 2 * L, generator=rng())
    q = Normal(parameters[:, :L], (parameters[:, L:] / 2).exp())
    found = latent.posterior(parameters, torch.zeros(B, L), tokens()).divergence
    torch.testing.assert_close(found, kl_divergence(q, prior))
