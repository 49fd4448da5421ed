"""The latent of the papers, and a density fitted to its encodings."""

import pytest
import torch
from latent_cases import MANY, B, L, make, posterior_of, rng, tokens
from torch.distributions import Normal, kl_divergence

from lerobot_act_chunking.nn.latents.normal import kl_between_normals, select_component


def test_the_divergence_from_a_standard_normal_is_torchs():
    latent = make("gaussian")
    parameters = torch.randn(B, 2 * L, generator=rng())
    mean, log_variance = parameters.chunk(2, -1)
    posterior = latent.posterior(parameters, torch.zeros(B, latent.n_noise), tokens())
    expected = kl_divergence(Normal(mean, (log_variance / 2).exp()), Normal(torch.zeros(L), torch.ones(L)))
    torch.testing.assert_close(posterior.divergence, expected)
    assert torch.equal(posterior.z, mean)
    assert torch.equal(posterior.mean, mean)


def test_the_divergence_between_normals_is_torchs():
    values = torch.randn(4, B, L, generator=rng()).unbind()
    q, p = (Normal(m, (v / 2).exp()) for m, v in (values[:2], values[2:]))
    torch.testing.assert_close(kl_between_normals(*values), kl_divergence(q, p))


def test_samples_of_the_posterior_have_its_mean_and_variance():
    latent = make("gaussian")
    parameters = torch.tensor([2.0] * L + [3.0] * L).log().expand(MANY, -1)
    z = latent.posterior(parameters, torch.randn(MANY, latent.n_noise, generator=rng()), tokens(MANY)).z
    torch.testing.assert_close(z.mean(0), parameters[0, :L], atol=0.05, rtol=0)
    torch.testing.assert_close(z.var(0), torch.full((L,), 3.0), atol=0.1, rtol=0)


def test_extreme_variances_stay_finite():
    for latent in (make("gaussian"), make("conditional")):
        for extreme in (-1e4, 1e4):
            parameters = torch.full((B, 2 * L), extreme)
            posterior = latent.posterior(parameters, torch.ones(B, latent.n_noise), tokens())
            assert posterior.divergence.isfinite().all()


def test_a_gaussian_acts_with_zero_or_a_standard_normal():
    latent = make("gaussian", z_temperature=0.5)
    assert torch.equal(latent.prior(None, tokens()), torch.zeros(B, L))
    noise = torch.randn(B, latent.n_noise, generator=rng())
    torch.testing.assert_close(latent.prior(noise, tokens()), 0.5 * noise[:, :L])


def fitted(**settings):
    latent = make("gaussian", **settings)
    means = 10 * torch.eye(L)[:3]
    scales = torch.tensor([1.0, 0.5, 0.1])[:, None, None] * torch.eye(L)
    scales[0, 1, 0] = 0.9  # correlated
    latent.fit_density(torch.tensor([0.8, 0.15, 0.05]), means, scales)
    return latent, means, scales


@pytest.mark.parametrize(
    ("settings", "shares"),
    [({}, [0.8, 0.15, 0.05]), ({"prior_component_weights": "uniform"}, [1 / 3] * 3)],
    ids=["empirical", "uniform"],
)
def test_a_fitted_density_is_sampled_by_its_weights(settings, shares):
    latent, means, scales = fitted(**settings)
    z = latent.prior(torch.randn(MANY, latent.n_noise, generator=rng()), tokens(MANY))
    component = torch.cdist(z, means).argmin(1)
    torch.testing.assert_close(component.bincount() / MANY, torch.tensor(shares), atol=0.01, rtol=0)
    first = z[component == 0]
    torch.testing.assert_close(first.mean(0), means[0], atol=0.05, rtol=0)
    torch.testing.assert_close(first.T.cov(), scales[0] @ scales[0].T, atol=0.08, rtol=0)


def test_the_mode_and_the_posterior_do_not_depend_on_the_fit():
    latent, plain = fitted()[0], make("gaussian")
    assert torch.equal(latent.prior(None, tokens()), torch.zeros(B, L))
    assert torch.equal(posterior_of(latent).divergence, posterior_of(plain).divergence)


def test_temperature_narrows_components_in_place():
    (cold, means, _), (warm, *_) = fitted(z_temperature=0.1), fitted()
    noise = torch.randn(B, warm.n_noise, generator=rng())
    centre = select_component(warm.weights, noise[:, -1])[:, :3] @ means
    expected = centre + 0.1 * (warm.prior(noise, tokens()) - centre)
    torch.testing.assert_close(cold.prior(noise, tokens()), expected)


def test_a_fit_is_saved_and_an_earlier_checkpoint_loads_strictly():
    latent, *_ = fitted()
    restored = make("gaussian")
    restored.load_state_dict(latent.state_dict())
    noise = torch.randn(B, latent.n_noise, generator=rng())
    assert torch.equal(restored.prior(noise, tokens()), latent.prior(noise, tokens()))
    fresh = make("gaussian")
    fresh.load_state_dict({})
    assert torch.equal(fresh.prior(noise, tokens()), noise[:, :L])


def test_a_second_fit_replaces_the_first():
    latent, *_ = fitted()
    latent.fit_density(torch.ones(1), torch.zeros(1, L), torch.eye(L)[None])
    noise = torch.randn(B, latent.n_noise, generator=rng())
    assert torch.equal(latent.prior(noise, tokens()), noise[:, :L])
