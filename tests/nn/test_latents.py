"""What every latent promises, and what none takes."""

import pytest
import torch
from latent_cases import TYPES, B, D, latent_spec, make, posterior_of, rng, tokens

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.latents.health import latent_metrics
from lerobot_act_chunking.nn.latents.make import LATENTS, make_latent


@pytest.mark.parametrize("latent_type", TYPES)
def test_sizes(latent_type):
    latent = make(latent_type)
    posterior = posterior_of(latent)
    assert posterior.z.shape == posterior.mean.shape == (B, latent.dim)
    assert posterior.divergence.shape[0] == B
    assert latent.prior(None, tokens()).shape == (B, latent.dim)
    assert latent.prior(torch.randn(B, latent.n_noise), tokens()).shape == (B, latent.dim)


@pytest.mark.parametrize("latent_type", TYPES)
def test_each_sample_has_its_own_noise(latent_type):
    latent = make(latent_type).eval()
    torch.nn.init.normal_(next(iter(latent.parameters()), torch.empty(0)))
    parameters, noise = torch.zeros(B, latent.n_parameters), torch.randn(B, latent.n_noise, generator=rng(3))
    other = noise.clone()
    other[1] = -5 * other[1] + torch.arange(latent.n_noise)
    for draw in (lambda n: latent.posterior(parameters, n, tokens()).z, lambda n: latent.prior(n, tokens())):
        same = (draw(noise) == draw(other)).all(-1)
        assert same[[0, 2]].all()
        assert not same[1]


@pytest.mark.parametrize("latent_type", TYPES)
def test_gradients_reach_the_encoder_through_z_and_divergence(latent_type):
    latent = make(latent_type)
    parameters = torch.randn(B, latent.n_parameters, generator=rng(), requires_grad=True)
    noise = torch.randn(B, latent.n_noise, generator=rng(1))
    for read in (lambda p: p.z[:, 0].sum(), lambda p: p.divergence.sum()):
        (gradient,) = torch.autograd.grad(read(latent.posterior(parameters, noise, tokens())), parameters)
        assert gradient.isfinite().all()
        assert gradient.abs().sum() > 0


@pytest.mark.parametrize("latent_type", TYPES)
def test_half_precision_parameters_are_computed_in_single(latent_type):
    latent = make(latent_type)
    noise = torch.zeros(B, latent.n_noise)
    parameters = torch.randn(B, latent.n_parameters, generator=rng()).bfloat16()
    assert latent.posterior(parameters, noise, tokens()).divergence.dtype == torch.float32


def test_metrics_of_latent_health():
    mean = torch.tensor([[0.0, 1.0, 0.05], [0.0, -1.0, -0.05]])
    divergence = torch.tensor([[0.0, 2.0, 0.02], [0.0, 3.0, 0.01]])
    metrics = {name: value.item() for name, value in latent_metrics(mean, divergence).items()}
    assert metrics == {"kl_max": 2.5, "kl_active_dims": 2.0, "active_units": 1.0}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"latent_type": "gauss"}, "unknown latent_type 'gauss'; choose one of: gaussian, conditional"),
        ({"prior_component_weights": "even"}, "unknown prior_component_weights 'even'"),
        ({"latent_dim": 0}, "latent_dim=0 must be at least 1"),
        ({"n_latent_components": 1}, "n_latent_components=1 must be at least 2"),
        ({"latent_warmup_steps": 0}, "latent_warmup_steps=0 must be at least 1"),
        (
            {"z_temperature": 0.0},
            "z_temperature=0.0 must be above 0 and at most 100: set z_temperature=1",
        ),
        ({"z_temperature": float("inf")}, "z_temperature=inf must be above 0 and at most 100"),
    ],
)
def test_settings_that_cannot_work(settings, message):
    with pytest.raises(ConfigurationError, match=message):
        make_latent(latent_spec(**settings), D)


@pytest.mark.parametrize("latent_type", TYPES)
def test_each_name_makes_its_latent(latent_type):
    assert type(make(latent_type)) is LATENTS[latent_type]
