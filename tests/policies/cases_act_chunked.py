"""Cases of `act_chunked`."""

import torch
from policy_case import ENVIRONMENT, STATE, TOP, VELOCITY, WRIST, Case, Kind, T
from torch import Tensor

ACT = {
    "chunk_size": T,
    "dim_model": 16,
    "n_heads": 2,
    "dim_feedforward": 24,
    "n_encoder_layers": 2,
    "n_vae_encoder_layers": 2,
    "latent_dim": 8,
    "dropout": 0.0,
    "vision_backbone": "small_cnn",
}
TWO_LAYERS = {"n_decoder_layers": 2, "actions_per_query": 1, "use_ema": True}  # queries attend to each other
SAMPLED = {
    "use_vae": True,
    "latent_type": "conditional",
    "z_inference": "sample",
    "action_likelihood": "gaussian",
    "action_temperature": 1.0,
}
AUTOREGRESSIVE = {
    "image_tokens": "summary",
    "decoder_type": "autoregressive",
    "actions_per_query": 1,
    "n_decoder_layers": 2,
}


def noise(case: Case, batch_size: int, generator: torch.Generator) -> dict[str, Tensor]:
    if not case.config().is_stochastic:
        return {}
    network = case.policy().model
    return {
        "noise": torch.randn(batch_size, network.latent.n_noise, generator=generator),
        "draws": torch.rand(batch_size, *network.head.draws_shape, generator=generator),
    }


KIND = Kind(ACT, {"dim_model": 32, "dim_feedforward": 64, "use_vae": False}, 160, noise)
CASES = [
    Case("state", "act_chunked", STATE),
    Case("environment", "act_chunked", ENVIRONMENT, TWO_LAYERS),
    Case("vectors", "act_chunked", STATE | VELOCITY | ENVIRONMENT, {"actions_per_query": 5, "use_vae": True}),
    Case("cameras", "act_chunked", TOP | WRIST, {"use_vae": True}),
    Case("mixed", "act_chunked", STATE | TOP, {"preset": "paper"}),
    Case("sampled", "act_chunked", STATE | ENVIRONMENT, SAMPLED),
    Case("autoregressive", "act_chunked", STATE | TOP, AUTOREGRESSIVE),
]
