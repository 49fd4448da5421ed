"""What the tests of all latents share."""

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
