"""Our samplers in the place of LeRobot's scheduler loop: same network, same noise, same chunk."""

from itertools import product

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
from lerobot.policies.diffusion.modeling_diffusion import DiffusionModel
from torch import Tensor

from lerobot_act_chunking.sampling.process import Diffusion
from lerobot_act_chunking.sampling.samplers import make_sampler

B, T, A, S, E = 3, 8, 4, 6, 7


def make_model(**settings) -> DiffusionModel:
    config = DiffusionConfig(
        input_features={
            "observation.state": PolicyFeature(FeatureType.STATE, (S,)),
            "observation.environment_state": PolicyFeature(FeatureType.ENV, (E,)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (A,))},
        device="cpu",
        horizon=T,
        n_action_steps=4,
        down_dims=(16, 32),
        diffusion_step_embed_dim=16,
        **settings,
    )
    torch.manual_seed(0)
    return DiffusionModel(config).eval()


def sample(
    model: DiffusionModel, noise: Tensor, condition: Tensor, generator: torch.Generator | None
) -> Tensor:
    config = model.config
    process = Diffusion(
        config.prediction_type,
        config.num_train_timesteps,
        config.beta_schedule,
        config.beta_start,
        config.beta_end,
    )
    sampler = make_sampler(
        process,
        config.noise_scheduler_type.lower(),
        config.num_inference_steps,
        clip=config.clip_sample_range if config.clip_sample else None,
        clip_mode="lerobot",
    )

    def denoise(x: Tensor, i: int) -> Tensor:
        time = sampler.times[i]
        output = model.unet(x, time.long().expand(len(x)), global_cond=condition)
        return process.clean(x, output, time)

    return sampler(denoise, noise, generator)


@pytest.mark.parametrize(
    ("noise_scheduler_type", "prediction_type", "clip_sample", "num_inference_steps"),
    [
        *product(("DDIM", "DDPM"), ("epsilon", "sample"), (True, False), (10,)),
        ("DDIM", "epsilon", True, 32),
        ("DDIM", "epsilon", True, 100),
        ("DDPM", "epsilon", True, 100),
    ],
)
def test_chunks_are_lerobots(noise_scheduler_type, prediction_type, clip_sample, num_inference_steps):
    model = make_model(
        noise_scheduler_type=noise_scheduler_type,
        prediction_type=prediction_type,
        clip_sample=clip_sample,
        num_inference_steps=num_inference_steps,
    )
    noise = torch.randn(B, T, A, generator=torch.Generator().manual_seed(1))
    condition = torch.randn(B, (S + E) * model.config.n_obs_steps, generator=torch.Generator().manual_seed(2))
    with torch.no_grad():
        theirs = model.conditional_sample(
            B, global_cond=condition, noise=noise, generator=torch.Generator().manual_seed(3)
        )
        ours = sample(model, noise, condition, torch.Generator().manual_seed(3))
    # One rounding of the noise moves LeRobot's own 100-step DDIM chunk by 4e-5: 1 / alpha is 2000 at step 99.
    atol = 1e-4 if noise_scheduler_type == "DDIM" and num_inference_steps > 10 else 1e-5
    torch.testing.assert_close(ours, theirs, atol=atol, rtol=1e-5)
