"""With LeRobot's weights `diffusion_chunked` is LeRobot's `diffusion`: loss, gradients, chunks, actions."""

import pytest
import torch
from diffusion_weights import convert
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy

from lerobot_act_chunking.data.batch import Observation
from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)
from lerobot_act_chunking.policies.diffusion_chunked.modeling_diffusion_chunked import DiffusionChunkedPolicy
from lerobot_act_chunking.policies.diffusion_chunked.training_noise import Draws
from lerobot_act_chunking.sampling.noise import NoiseSource

B, H, T, A, S, E = 3, 2, 8, 4, 6, 7
SETTINGS = {
    "n_obs_steps": H,
    "horizon": T,
    "n_action_steps": 5,
    "down_dims": (16, 32),
    "diffusion_step_embed_dim": 16,
    "num_inference_steps": 10,
}


def pair(**settings):
    """The two policies with the same weights."""
    features = {
        "input_features": {
            "observation.state": PolicyFeature(FeatureType.STATE, (S,)),
            "observation.environment_state": PolicyFeature(FeatureType.ENV, (E,)),
        },
        "output_features": {"action": PolicyFeature(FeatureType.ACTION, (A,))},
        "device": "cpu",
        "push_to_hub": False,
    }
    torch.manual_seed(0)
    common = {**features, **SETTINGS, **settings}
    theirs = DiffusionPolicy(DiffusionConfig(noise_scheduler_type="DDIM", **common)).eval()
    ours = DiffusionChunkedPolicy(DiffusionChunkedConfig(preset="paper", sampler="ddim", **common)).eval()
    weights = convert(theirs.diffusion.unet.state_dict(), n_levels=2, time_dim=16)
    ours.model.denoiser.load_state_dict(weights, strict=True)
    return theirs, ours


def observations(n_steps):
    generator = torch.Generator().manual_seed(1)
    return [
        {
            "observation.state": torch.randn(B, S, generator=generator),
            "observation.environment_state": torch.randn(B, E, generator=generator),
        }
        for _ in range(n_steps)
    ]


def window():
    steps = observations(H)
    return {key: torch.stack([step[key] for step in steps], dim=1) for key in steps[0]}


@pytest.mark.parametrize("prediction_type", ["epsilon", "sample"])
def test_the_same_loss_and_gradients(prediction_type):
    theirs, ours = pair(prediction_type=prediction_type)
    actions = torch.randn(B, T, A)
    batch = {**window(), "action": actions, "action_is_pad": torch.zeros(B, T, dtype=torch.bool)}
    torch.manual_seed(2)
    loss, _ = theirs.forward(dict(batch))
    loss.backward()
    torch.manual_seed(2)  # and the same draws in LeRobot's order
    noise, time = torch.randn(B, T, A), torch.randint(0, 100, (B,)).float()
    window_of_both = Observation.window_from_lerobot(batch, ours.feature_spec, H)
    error = ours._error(window_of_both, actions, Draws(time, noise))
    error.mean().backward()
    assert error.mean().item() == pytest.approx(loss.item(), rel=1e-6)
    gradients = {name: p.grad for name, p in theirs.diffusion.unet.named_parameters()}
    expected = convert(gradients, n_levels=2, time_dim=16)
    for name, parameter in ours.model.denoiser.named_parameters():
        torch.testing.assert_close(parameter.grad, expected[name], rtol=1e-4, atol=1e-6, msg=name)


@pytest.mark.parametrize("prediction_type", ["epsilon", "sample"])
@pytest.mark.parametrize("clip_sample", [True, False])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_same_ddim_chunk(prediction_type, clip_sample, seed):
    theirs, ours = pair(prediction_type=prediction_type, clip_sample=clip_sample)
    noise = torch.randn(B, T, A, generator=torch.Generator().manual_seed(seed))
    expected = theirs.predict_action_chunk(window(), noise=noise)
    chunk = ours.predict_action_chunk(window(), noise=noise)[:, :5]
    torch.testing.assert_close(chunk, expected, rtol=1e-5, atol=1e-5)


def test_the_same_actions_over_a_rollout(monkeypatch):
    theirs, ours = pair()
    noise = torch.randn(B, T, A, generator=torch.Generator().manual_seed(3))
    monkeypatch.setattr(NoiseSource, "draw", lambda *_, **__: noise)
    for observation in observations(12):
        expected = theirs.select_action(dict(observation), noise=noise)
        torch.testing.assert_close(ours.select_action(observation), expected, rtol=1e-5, atol=1e-5)
