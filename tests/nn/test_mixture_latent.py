"""The latent whose prior is a mixture."""

import pytest
import torch
from latent_cases import MANY, B, L, M, make, posterior_of, rng, tokens
from torch.distributions import Categorical, MixtureSameFamily, MultivariateNormal

from lerobot_act_chunking.nn.latents.mixture import MixtureLatent
from lerobot_act_chunking.nn.latents.normal import kl_between_normals


def clusters(n, centres, seed=0):
    """Parameters of posteriors around centres, with standard deviation 0.1 in both senses."""
    which = torch.arange(n) % len(centres)
    mean = centres[which] + 0.1 * torch.randn(n, L, generator=rng(seed))
    return torch.cat((mean, torch.full((n, L), 2 * torch.log(torch.tensor(0.1)))), -1)


CENTRES = torch.tensor([[3.0, 0, 0, 0], [0, -3, 0, 0], [0, 0, 3, 1.0]])


def warmed_up(**settings):
    latent = MixtureLatent(L, 3, warmup_steps=4, **settings)
    for step in range(5):
        parameters = clusters(30, CENTRES, seed=step)
        latent.posterior(parameters, torch.zeros(30, latent.n_noise), tokens(30))
    return latent


def test_a_mixture_is_standard_until_its_components_are_placed():
    latent = MixtureLatent(L, 3, warmup_steps=4)
    for step in range(4):
        assert not latent.placed
        parameters = clusters(30, CENTRES, seed=step)
        posterior = latent.posterior(parameters, torch.zeros(30, latent.n_noise), tokens(30))
        gaussian = make("gaussian").posterior(parameters, torch.zeros(30, L), tokens(30))
        torch.testing.assert_close(posterior.divergence[:, 0], gaussian.divergence.sum(-1))
    noise = torch.randn(B, latent.n_noise, generator=rng())
    assert torch.equal(latent.prior(noise, tokens()), noise[:, :L])
    latent.posterior(parameters, torch.zeros(30, latent.n_noise), tokens(30))
    assert latent.placed


def test_components_are_placed_where_encodings_are():
    latent = warmed_up()
    found = latent.means[torch.cdist(CENTRES, latent.means).argmin(1)]
    torch.testing.assert_close(found, CENTRES, atol=0.1, rtol=0)
    # within a cluster and of each posterior, 0.01 each; the latter's average has come from 1 to 0.82
    assert (latent.log_variances.exp() < 1.0).all()
    torch.testing.assert_close(latent.logits.softmax(-1), torch.full((3,), 1 / 3), atol=0.01, rtol=0)


def test_evaluation_neither_counts_nor_places():
    latent = MixtureLatent(L, 3, warmup_steps=1).eval()
    for _ in range(3):
        posterior_of(latent)
    assert not latent.placed
    assert not latent.means.any()


def test_the_mixtures_density_is_torchs():
    latent = warmed_up()
    latent.logits.data = torch.randn(3, generator=rng())
    z = torch.randn(B, L, generator=rng())
    scales = (latent.log_variances / 2).exp()
    components = MultivariateNormal(latent.means, scale_tril=scales.diag_embed())
    expected = MixtureSameFamily(Categorical(logits=latent.logits), components).log_prob(z)
    torch.testing.assert_close(latent.log_prior(z), expected)


def test_the_one_sample_divergence_of_a_mixture_is_right_on_average():
    """With all components alike, the mixture is one normal, whose divergence has a closed form."""
    latent = warmed_up().eval()
    latent.means.data[:] = torch.tensor([0.5, -0.2, 0.0, 1.0])
    latent.log_variances.data[:] = torch.tensor([0.3, -0.5, 0.0, 0.8])
    parameters = torch.randn(1, 2 * L, generator=rng())
    noise = torch.randn(MANY, latent.n_noise, generator=rng(1))
    found = latent.posterior(parameters.expand(MANY, -1), noise, tokens(MANY)).divergence
    expected = kl_between_normals(*parameters.chunk(2, -1), latent.means[:1], latent.log_variances[:1]).sum()
    assert found.shape == (MANY, 1)
    error = found.std().item() / MANY**0.5
    assert found.mean().item() == pytest.approx(expected.item(), abs=4 * error)


def test_mixture_components_learn_once_placed():
    latent = warmed_up()
    posterior_of(latent).divergence.sum().backward()
    for parameter in latent.parameters():
        assert parameter.grad is not None
        assert parameter.grad.abs().sum() > 0


def test_uniform_mixture_weights_are_not_learned():
    latent = warmed_up(uniform=True)
    posterior_of(latent).divergence.sum().backward()
    assert latent.logits.grad is None
    assert not latent.logits.any()


def test_a_mixture_is_sampled_around_its_components():
    latent = warmed_up(temperature=0.1).eval()
    latent.logits.data = torch.tensor([0.5, 0.2, 0.3]).log()
    z = latent.prior(torch.randn(MANY, latent.n_noise, generator=rng()), tokens(MANY))
    distance, component = torch.cdist(z, latent.means).min(1)
    torch.testing.assert_close(component.bincount() / MANY, torch.tensor([0.5, 0.2, 0.3]), atol=0.01, rtol=0)
    deviation = (latent.log_variances / 2).exp()
    assert (distance < 0.1 * 6 * deviation.max() * L**0.5).all()


def test_the_mode_of_a_mixture_is_its_highest_peak():
    latent = warmed_up().eval()
    latent.log_variances.data[:] = 0.0
    latent.log_variances.data[1] = -1.0
    torch.testing.assert_close(latent.prior(None, tokens()), latent.means[1].expand(B, -1))
    latent.logits.data[2] = 5.0
    torch.testing.assert_close(latent.prior(None, tokens()), latent.means[2].expand(B, -1))


def test_a_resumed_warm_up_places_the_same_components():
    half, whole = MixtureLatent(L, 3, warmup_steps=4), warmed_up()
    for step in range(2):
        half.posterior(clusters(30, CENTRES, seed=step), torch.zeros(30, half.n_noise), tokens(30))
    resumed = MixtureLatent(L, 3, warmup_steps=4)
    resumed.load_state_dict(half.state_dict())
    for step in range(2, 5):
        resumed.posterior(clusters(30, CENTRES, seed=step), torch.zeros(30, resumed.n_noise), tokens(30))
    assert torch.equal(resumed.means, whole.means)


def test_fewer_encodings_than_components():
    latent = MixtureLatent(L, M, warmup_steps=1)
    for step in range(2):
        latent.posterior(clusters(2, CENTRES, seed=step), torch.zeros(2, latent.n_noise), tokens(2))
    assert latent.placed
    assert (latent.means != 0).any(1).sum() == 2
