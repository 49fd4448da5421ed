"""What the tests of all latents share."""

import torch

from lerobot_act_chunking.nn.latents.make import LATENTS, make_latent
from lerobot_act_chunking.nn.latents.spec import LatentSpec

USUAL = {
    "latent_type": "gaussian",
    "latent_dim": 4,
    "n_latent_components": 6,
    "latent_warmup_steps": 1000,
    "prior_component_weights": "empirical",
    "z_temperature": 1.0,
}


def latent_spec(**settings) -> LatentSpec:
    return LatentSpec(**USUAL | settings)


B, N, D, L, M, MANY = 3, 5, 16, 4, 6, 20_000
TYPES = sorted(LATENTS)


def rng(seed=0):
    return torch.Generator().manual_seed(seed)


def tokens(n=B):
    return torch.randn(n, N, D, generator=rng(9))


def make(latent_type, **settings):
    torch.manual_seed(0)
    return make_latent(latent_spec(latent_type=latent_type, **settings), D)


def posterior_of(latent, n=B, seed=0):
    noise = torch.randn(n, latent.n_noise, generator=rng(seed + 1))
    return latent.posterior(torch.randn(n, latent.n_parameters, generator=rng(seed)), noise, tokens(n))
