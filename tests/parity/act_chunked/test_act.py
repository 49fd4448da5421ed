"""`act_chunked` with the weights of LeRobot's ``act``: same chunks, losses and gradients, in float64."""

from dataclasses import dataclass
from itertools import product

import pytest
import torch
from act_weights import convert
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from torch import Tensor

from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig
from lerobot_act_chunking.policies.act_chunked.modeling_act_chunked import ActChunkedPolicy

B, T, A, S, E = 3, 5, 4, 6, 7
STATE = {"observation.state": PolicyFeature(FeatureType.STATE, (S,))}
ENVIRONMENT = {"observation.environment_state": PolicyFeature(FeatureType.ENV, (E,))}
CAMERAS = {f"observation.images.{name}": PolicyFeature(FeatureType.VISUAL, (3, 32, 64)) for name in "ab"}
ACTION = {"action": PolicyFeature(FeatureType.ACTION, (A,))}
INPUTS = {"state+environment": STATE | ENVIRONMENT, "state+cameras": STATE | CAMERAS}


@dataclass
class Pair:
    theirs: ACTPolicy
    ours: ActChunkedPolicy
    batch: dict[str, Tensor]


def make_pair(inputs: str, pre_norm: bool, n_decoder_layers: int, use_vae: bool) -> Pair:
    torch.manual_seed(0)
    shared = {
        "input_features": INPUTS[inputs],
        "output_features": ACTION,
        "device": "cpu",
        "chunk_size": T,
        "n_action_steps": T,
        "dim_model": 16,
        "n_heads": 2,
        "dim_feedforward": 24,
        "latent_dim": 8,
        "n_encoder_layers": 2,
        "n_vae_encoder_layers": 2,
        "dropout": 0.0,
        "pre_norm": pre_norm,
        "n_decoder_layers": n_decoder_layers,
        "use_vae": use_vae,
        "pretrained_backbone_weights": None,
    }
    theirs = ACTPolicy(ACTConfig(**shared)).double()
    for name, parameter in theirs.named_parameters():
        if "backbone" not in name:  # many biases start at zero, which would hide mistakes
            parameter.data += 0.1 * torch.randn_like(parameter)
    ours = ActChunkedPolicy(ActChunkedConfig(preset="paper", **shared)).double()
    ours.load_state_dict(convert(theirs.state_dict(), theirs)[0], strict=True)
    # LeRobot's zero latent is float32 whatever the weights are.
    theirs.model.encoder_latent_input_proj.register_forward_pre_hook(lambda _, args: (args[0].double(),))
    return Pair(theirs, ours, make_batch(INPUTS[inputs]))


def make_batch(features: dict[str, PolicyFeature]) -> dict[str, Tensor]:
    batch = {key: torch.rand(B, *feature.shape, dtype=torch.float64) for key, feature in features.items()}
    batch["action"] = torch.randn(B, T, A, dtype=torch.float64)
    batch["action_is_pad"] = torch.arange(T) >= torch.tensor([[T], [2], [4]])
    return batch


CASES = [
    *product(["state+environment"], (False, True), (1, 2), (False, True)),
    ("state+cameras", False, 1, True),
    ("state+cameras", True, 1, False),
]


@pytest.fixture(
    scope="module",
    params=CASES,
    ids=lambda case: (
        f"{case[0]}-{'pre' if case[1] else 'post'}-{case[2]}layer-{'vae' if case[3] else 'plain'}"
    ),
)
def pair(request) -> Pair:
    return make_pair(*request.param)


def test_chunks_are_equal(pair):
    torch.testing.assert_close(
        pair.ours.predict_action_chunk(pair.batch),
        pair.theirs.predict_action_chunk(pair.batch),
        rtol=0,
        atol=1e-12,
    )


@pytest.mark.parametrize("training", [True, False])
def test_losses_and_gradients_are_equal(pair, training, monkeypatch):
    noise = torch.randn(B, 8, dtype=torch.float64)  # of the style latent; ours draws one more
    monkeypatch.setattr(torch, "randn_like", lambda _: noise)
    monkeypatch.setattr(torch, "randn", lambda *_, **__: torch.nn.functional.pad(noise, (0, 1)))
    losses = []
    for policy in (pair.theirs.train(training), pair.ours.train(training)):
        policy.zero_grad(set_to_none=True)
        loss, metrics = policy.forward(pair.batch)
        loss.backward()
        losses.append({"loss": loss.item(), **metrics})
    assert {name: losses[1][name] for name in losses[0]} == pytest.approx(losses[0], rel=1e-12)
    gradients, without_effect = convert(_gradients(pair.theirs), pair.theirs, gradients=True)
    for name, parameter in pair.ours.named_parameters():
        if name.endswith("cameras.identities"):
            continue
        expected = gradients.pop(name)
        actual = torch.zeros_like(expected) if parameter.grad is None else parameter.grad
        torch.testing.assert_close(
            actual, expected, rtol=1e-9, atol=1e-12, msg=lambda text, name=name: f"{name}: {text}"
        )
    for name, gradient in without_effect.items():
        assert gradient.abs().max() < 1e-12, name


def _gradients(policy: ACTPolicy) -> dict[str, Tensor]:
    return {
        name: torch.zeros_like(parameter) if parameter.grad is None else parameter.grad
        for name, parameter in policy.named_parameters()
    }
