import re

import pytest
import torch
from torch import nn
from torchvision.ops.misc import FrozenBatchNorm2d

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.vision import FrozenBatchNorm, SmallCnn, make_backbone


@pytest.mark.parametrize(("name", "stride"), [("small_cnn", 16), ("resnet18", 32)])
def test_feature_maps_have_the_promised_channels_and_stride(name, stride):
    backbone, channels = make_backbone(name, "group", None)
    features = backbone(torch.rand(2, 3, 2 * stride, 3 * stride))
    assert features.shape == (2, channels, 2, 3)


@pytest.mark.parametrize(("norm", "kind"), [("group", nn.GroupNorm), ("frozen_batch", FrozenBatchNorm2d)])
def test_norm_layers(norm, kind):
    backbone, _ = make_backbone("resnet18", norm, None)
    assert sum(isinstance(module, kind) for module in backbone.modules()) == 20


def test_frozen_batch_norm_is_torchvisions():
    ours, theirs = FrozenBatchNorm(5), FrozenBatchNorm2d(5)
    for value in ours.state_dict().values():
        value += torch.rand(5)
    theirs.load_state_dict(ours.state_dict())
    results = []
    x = torch.randn(2, 5, 3, 4)
    for norm in (ours, theirs):
        seen = x.clone().requires_grad_()
        y = norm(seen)
        y.sin().sum().backward()
        results.append((y, seen.grad))
    torch.testing.assert_close(*results)


@pytest.mark.parametrize("norm", ["group", "frozen_batch"])
@pytest.mark.parametrize("name", ["small_cnn", "resnet18"])
def test_evaluation_stores_weights_otherwise_and_answers_the_same(name, norm):
    backbone, _ = make_backbone(name, norm, None)
    images, optimizer = torch.rand(2, 3, 64, 96), torch.optim.AdamW(backbone.parameters())
    for _ in range(2):  # there and back
        weights = [p for p in backbone.train().parameters() if p.ndim == 4]
        assert all(weight.is_contiguous() for weight in weights)
        expected = backbone(images)
        expected.sum().backward()
        optimizer.step()
        states = [optimizer.state[weight]["exp_avg"] for weight in weights]
        assert all(state.is_contiguous() for state in states)  # or LeRobot could not save them
        expected = backbone(images)
        backbone.eval()
        assert all(weight.is_contiguous(memory_format=torch.channels_last) for weight in weights)
        torch.testing.assert_close(backbone(images), expected, rtol=1e-4, atol=1e-4)


def test_small_cnn_is_small():
    assert sum(p.numel() for p in SmallCnn().parameters()) < 400_000


def test_weights_of_another_backbone():
    with pytest.raises(ConfigurationError, match=r"choose one of: ResNet18_Weights\.IMAGENET1K_V1"):
        make_backbone("resnet18", "frozen_batch", "ResNet34_Weights.IMAGENET1K_V1")


def test_weights_that_are_not_cached(monkeypatch, tmp_path):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    message = f"Put resnet18-f37072fd.pth .* into {re.escape(str(tmp_path / 'hub' / 'checkpoints'))}"
    with pytest.raises(ConfigurationError, match=message):
        make_backbone("resnet18", "frozen_batch", "ResNet18_Weights.IMAGENET1K_V1")


def test_cached_weights_are_loaded(monkeypatch, tmp_path):
    from torchvision.models import ResNet18_Weights, resnet18

    file = tmp_path / "hub" / "checkpoints" / "resnet18-f37072fd.pth"
    file.parent.mkdir(parents=True)
    stored = resnet18(weights=None)
    torch.save(stored.state_dict(), file)
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.setattr(ResNet18_Weights, "get_state_dict", lambda *_, **__: torch.load(file))
    backbone, _ = make_backbone("resnet18", "frozen_batch", "ResNet18_Weights.IMAGENET1K_V1")
    assert torch.equal(backbone.state_dict()["layer3.0.conv2.weight"], stored.layer3[0].conv2.weight)
