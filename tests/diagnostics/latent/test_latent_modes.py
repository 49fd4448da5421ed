"""Three ways to go, demonstrated 80 / 15 / 5 %: which latents keep them apart, and which priors find them."""

import math

import pytest
import torch
from torch import nn

from lerobot_act_chunking.diagnostics.latent.density import fit_density, with_density
from lerobot_act_chunking.nn.latents.make import make_latent
from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig

SHARES, T, B, D = torch.tensor([0.8, 0.15, 0.05]), 10, 128, 4
ANGLES = torch.arange(3) * 2 * math.pi / 3
PATHS = (torch.arange(1, T + 1)[:, None] / T * torch.stack([ANGLES.cos(), ANGLES.sin()], 1)[:, None]).flatten(
    1
)
MANY, VALID = 4000, 0.1


def demonstrations(n, generator):
    mode = torch.multinomial(SHARES, n, replacement=True, generator=generator)
    return PATHS[mode] + 0.02 * torch.randn(n, 2 * T, generator=generator)


class Cvae(nn.Module):
    def __init__(self, spec):
        super().__init__()
        self.latent = make_latent(spec, D)
        self.encoder = nn.Sequential(nn.Linear(2 * T, 64), nn.ReLU(), nn.Linear(64, self.latent.n_parameters))
        self.decoder = nn.Sequential(nn.Linear(self.latent.dim, 64), nn.ReLU(), nn.Linear(64, 2 * T))

    def posterior(self, actions, generator):
        noise = torch.randn(len(actions), self.latent.n_noise, generator=generator)
        return self.latent.posterior(self.encoder(actions), noise, torch.zeros(len(actions), 1, D))


def trained(beta, latent_type, **settings):
    torch.manual_seed(0)
    generator = torch.Generator().manual_seed(0)
    sizes = {"latent_dim": 2, "latent_warmup_steps": 200}
    model = Cvae(ActChunkedConfig(device="cpu", latent_type=latent_type, **sizes, **settings).latent_spec)
    optimizer = torch.optim.Adam(model.parameters(), 3e-3)
    for _ in range(600):
        actions = demonstrations(B, generator)
        posterior = model.posterior(actions, generator)
        error = (model.decoder(posterior.z) - actions).abs().mean()
        optimizer.zero_grad()
        (error + beta * posterior.divergence.sum(-1).mean()).backward()
        optimizer.step()
    return model.eval()


@torch.no_grad()
def modes(model, z):
    """Share of each way among decoded styles, and of what is none of them."""
    distance = (model.decoder(z)[:, None] - PATHS).square().mean(-1).sqrt()
    nearest, mode = distance.min(1)
    valid = nearest < VALID
    return (mode[valid].bincount(minlength=3) / len(z)).tolist(), (~valid).float().mean().item()


@torch.no_grad()
def encoded(model):
    generator = torch.Generator().manual_seed(1)
    return model.posterior(demonstrations(MANY, generator), generator)


@torch.no_grad()
def sampled(latent):
    noise = torch.randn(MANY, latent.n_noise, generator=torch.Generator().manual_seed(2))
    return latent.prior(noise, torch.zeros(MANY, 1, D))


@pytest.fixture(scope="module")
def gaussian():
    return trained(0.003, "gaussian")


def test_the_posterior_knows_all_ways_and_the_standard_normal_does_not(gaussian):
    shares, invalid = modes(gaussian, encoded(gaussian).z)
    assert shares == pytest.approx(SHARES.tolist(), abs=0.03)
    assert invalid < 0.02
    shares, invalid = modes(gaussian, sampled(gaussian.latent))
    assert shares[2] < 0.25 * SHARES[2]
    assert invalid > 0.2


def test_a_fitted_density_repairs_the_prior(gaussian):
    density = fit_density(encoded(gaussian).z[:1500].double().numpy(), seed=0)
    latent = with_density(gaussian.latent, density)
    shares, invalid = modes(gaussian, sampled(latent))
    assert shares == pytest.approx(SHARES.tolist(), abs=0.04)
    assert invalid < 0.05
    latent.uniform = True
    shares, invalid = modes(gaussian, sampled(latent))
    assert min(shares) > SHARES[2]
    assert invalid < 0.1


def test_too_strong_a_pull_collapses_the_posterior_onto_the_most_frequent_way():
    model = trained(1.0, "gaussian")
    posterior = encoded(model)
    assert posterior.divergence.sum(-1).mean() < 0.01
    assert modes(model, posterior.z)[0] == pytest.approx([1.0, 0.0, 0.0])


def test_a_mixture_samples_all_ways_equally_often():
    model = trained(0.003, "mixture", n_latent_components=3, prior_component_weights="uniform")
    shares, invalid = modes(model, sampled(model.latent))
    assert shares == pytest.approx([1 / 3] * 3, abs=0.05)
    assert invalid < 0.05


def test_codes_separate_the_ways():
    model = trained(0.001, "categorical", n_latent_components=4)
    shares, invalid = modes(model, encoded(model).z)
    assert shares == pytest.approx(SHARES.tolist(), abs=0.03)
    assert invalid == 0
    shares, invalid = modes(model, sampled(model.latent))
    assert shares == pytest.approx(SHARES.tolist(), abs=0.05)
    assert invalid == 0
