"""Cases of `diffusion_chunked`."""

import torch
from policy_case import ENVIRONMENT, STATE, TOP, VELOCITY, WRIST, A, Case, Kind, T
from torch import Tensor

DIFFUSION = {
    "horizon": T,
    "dim_model": 16,
    "n_layers": 2,
    "n_heads": 2,
    "down_dims": (8,),
    "n_groups": 4,
    "diffusion_step_embed_dim": 8,
    "spatial_softmax_num_keypoints": 3,
    "vision_backbone": "small_cnn",
}
DDPM = {"objective": "ddpm", "clip_sample_range": 4.0}  # the actions are not normalised
PAPER_AT_T = {"n_obs_steps": 1, "n_action_steps": T, "sampler": "ddim", "num_inference_steps": 20} | DDPM
GUIDED = {
    "guidance_features": ["observation.environment_state"],
    "condition_dropout": 0.5,
    "guidance_scale": 1.5,
}


def noise(case: Case, batch_size: int, generator: torch.Generator) -> dict[str, Tensor]:
    return {"noise": torch.randn(batch_size, T, A, generator=generator)}


KIND = Kind(
    DIFFUSION,
    {
        "dim_model": 48,
        "down_dims": (48,),
        "condition_dropout": 0.0,
        "guidance_scale": 1.0,
    },
    400,
    noise,
)
CASES = [
    Case("state", "diffusion_chunked", STATE, {"actions_per_token": 1}),
    Case("velocity", "diffusion_chunked", STATE | ENVIRONMENT, {"prediction_type": "velocity"}),
    Case("two-step", "diffusion_chunked", STATE | VELOCITY, {"objective": "two_step"}),
    Case("dit", "diffusion_chunked", ENVIRONMENT | TOP, {"denoiser": "dit", "use_ema": False}),
    Case("unet", "diffusion_chunked", STATE | TOP | WRIST, {"denoiser": "unet1d"} | DDPM),
    Case("paper", "diffusion_chunked", STATE | ENVIRONMENT, {"preset": "paper"} | PAPER_AT_T),
    Case("goal", "diffusion_chunked", STATE | ENVIRONMENT, {"denoiser": "dit"} | GUIDED),
    Case("prefix", "diffusion_chunked", STATE, {"actions_per_token": 1, "prefix_steps": 2}),
]
