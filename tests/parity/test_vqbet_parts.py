"""VQ-BeT's heads and inputs beside LeRobot's: same outputs and gradients."""

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.vqbet.configuration_vqbet import VQBeTConfig
from lerobot.policies.vqbet.modeling_vqbet import MLP, FocalLoss, VQBeTRgbEncoder
from torch import nn
from vqbet_weights import Map

from lerobot_act_chunking.heads.codes import CodeHead, focal_loss
from lerobot_act_chunking.heads.offsets import TableOffset
from lerobot_act_chunking.nn.condition import CameraKeypoints
from lerobot_act_chunking.nn.history import HistoryTokens
from lerobot_act_chunking.nn.vision import make_backbone

N, G, M, C, A, D, K, B, H, IN = 5, 2, 6, 3, 4, 16, 7, 2, 3, 24


def load(module, linear):
    """Give ``module`` the weights of LeRobot's one linear layer."""
    module.load_state_dict({f"readout.{name}": value for name, value in linear[0].state_dict().items()})
    return module


@pytest.fixture
def features():
    return torch.randn(N, D, dtype=torch.float64)


@pytest.fixture
def codes():
    return torch.randint(M, (N, G))


def test_all_codes_at_once_are_lerobots_linear_head(features, codes):
    theirs = MLP(D, hidden_channels=[G * M]).double()
    ours = load(CodeHead(D, (), G, M, sequential=False).double(), theirs)
    expected = theirs(features).reshape(N, G, M)
    torch.testing.assert_close(ours.logits(features, codes), expected, rtol=0, atol=1e-12)


def test_codes_in_sequence_contain_lerobots_sequential_head(features, codes):
    """Its matrix of the first code, one-hot, is a vector per code in front of the second readout."""
    first = MLP(D, hidden_channels=[M]).double()
    second = MLP(D + M, hidden_channels=[M]).double()
    ours = CodeHead(D, (), G, M, sequential=True).double()
    of_features, of_codes = second[0].weight.split([D, M], dim=1)
    ours.load_state_dict(
        {
            "readout.weight": torch.cat((first[0].weight, of_features)),
            "readout.bias": torch.cat((first[0].bias, second[0].bias)),
            "context.levels": torch.zeros(G, D),
            "context.values": (of_features.pinverse() @ of_codes).T[None],
        }
    )
    one_hot = nn.functional.one_hot(codes[:, 0], M)
    expected = torch.stack((first(features), second(torch.cat((features, one_hot), dim=1))), dim=1)
    torch.testing.assert_close(ours.logits(features, codes), expected, rtol=0, atol=1e-12)


def test_offsets_are_lerobots_table(features, codes):
    theirs = MLP(D, hidden_channels=[G * M * C * A]).double()
    ours = load(TableOffset(D, (), G, M, C, A).double(), theirs)
    table = theirs(features).reshape(N, G, M, C * A)  # LeRobot's "(NT) (G C WA) -> (NT) G C WA"
    expected = table[torch.arange(N)[:, None], torch.arange(G), codes].sum(1).reshape(N, C, A)
    actual = ours(features, codes, torch.randn(N, C, A))
    torch.testing.assert_close(actual, expected, rtol=0, atol=1e-12)
    gradients = []
    for layer, offsets in ((theirs[0], expected), (ours.readout, actual)):
        offsets.sin().sum().backward()
        gradients.append((layer.weight.grad, layer.bias.grad))
    torch.testing.assert_close(gradients[1], gradients[0], rtol=0, atol=1e-12)


@pytest.mark.parametrize("gamma", [0.0, 1.0, 2.0, 3.5])
@pytest.mark.parametrize("scale", [0.1, 1.0, 10.0])
def test_focal_loss_and_its_gradient_are_lerobots(codes, gamma, scale):
    logits = scale * torch.randn(N, G, M, dtype=torch.float64)
    results = []
    for loss in (FocalLoss(gamma=gamma), lambda x, y: focal_loss(x, y, gamma).mean()):
        seen = logits.clone().requires_grad_()
        value = loss(seen, codes)
        value.backward()
        results.append((value, seen.grad))
    torch.testing.assert_close(results[1], results[0], rtol=1e-9, atol=1e-13)


def shaken(module):
    """Batch norms start at zero and one, which would hide mistakes."""
    for norm in module.modules():
        if isinstance(norm, nn.BatchNorm2d):
            for value in (norm.weight.data, norm.bias.data, norm.running_mean):
                value += 0.1 * torch.randn_like(value)
            norm.running_var *= 0.5 + torch.rand_like(norm.running_var)
    return module


def test_camera_tokens_are_lerobots():
    torch.manual_seed(0)
    shape = (3, 64, 96)
    config = VQBeTConfig(
        device="cpu",
        input_features={"observation.image": PolicyFeature(FeatureType.VISUAL, shape)},
        crop_shape=None,
        pretrained_backbone_weights=None,
        spatial_softmax_num_keypoints=K,
    )
    encoder = shaken(VQBeTRgbEncoder(config)).double().eval()
    projector, wte = MLP(2 * K, hidden_channels=[IN]).double(), nn.Linear(IN, D).double()
    backbone = make_backbone("resnet18", "frozen_batch", None)
    ours = HistoryTokens({}, CameraKeypoints({"observation.image": shape}, K, *backbone), D).double()
    mapping = Map(
        {f"rgb.{key}": value for key, value in encoder.state_dict().items()}
        | {f"policy.transformer.wte.{key}": value for key, value in wte.state_dict().items()}
        | {f"projector.{key}": value for key, value in projector.state_dict().items()}
        | {"token": torch.zeros(1, 1, IN, dtype=torch.float64)}
    )
    mapping.cameras("rgb.", "cameras.")
    mapping.inputs({"projector.0": "images"}, ("token", "query"))
    assert not mapping.theirs
    del mapping.ours["query"]
    ours.load_state_dict(mapping.ours, strict=True)
    images = torch.rand(B, H, *shape, dtype=torch.float64)
    expected = wte(projector(encoder(images.flatten(0, 1)))).unflatten(0, (B, H))
    actual = ours({}, {"observation.image": images})[:, :, 0]
    torch.testing.assert_close(actual, expected, rtol=0, atol=1e-9)
