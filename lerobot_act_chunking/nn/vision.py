"""Image backbones: what turns a camera image into a feature map."""

from collections import OrderedDict
from pathlib import Path
from typing import Literal

import torch
import torch.nn.functional as F  # noqa: N812
import torchvision
from jaxtyping import Float
from torch import Tensor, nn
from torchvision.models import ResNet, WeightsEnum, resnet18, resnet34, resnet50
from torchvision.ops.misc import FrozenBatchNorm2d

from lerobot_act_chunking.errors import ConfigurationError, unknown_choice

Backbone = Literal["small_cnn", "resnet18", "resnet34", "resnet50"]
BackboneNorm = Literal["group", "frozen_batch"]

RESNETS = {"resnet18": resnet18, "resnet34": resnet34, "resnet50": resnet50}
GROUP_SIZE = 16  # channels per group, as in Diffusion Policy's ResNet


def make_backbone(name: Backbone, norm: BackboneNorm, weights: str | None) -> tuple[nn.Module, int]:
    """A backbone and the channels of its feature map.

    Args:
        name: `SmallCnn` (stride 16) or a torchvision ResNet without its pooling and classifier (stride 32).
        norm: GroupNorm, to train from scratch, or BatchNorm with frozen statistics, for pretrained weights.
        weights: name of torchvision weights, such as ``ResNet18_Weights.IMAGENET1K_V1``, or None.

    Raises:
        ConfigurationError: for weights that are unknown, belong to another backbone, or are not in the
            cache of torch hub (nothing is ever downloaded).
    """
    if name == "small_cnn":
        return SmallCnn(), SmallCnn.CHANNELS[-1]
    norm_layer = FrozenBatchNorm if norm == "frozen_batch" else group_norm
    resnet: ResNet = RESNETS[name](weights=None, norm_layer=norm_layer)
    if weights is not None:
        resnet.load_state_dict(cached_weights(name, weights).get_state_dict(check_hash=True))
    body = list(resnet.named_children())[:-2]
    return ResnetBody(OrderedDict(body)), resnet.fc.in_features


def group_norm(channels: int) -> nn.GroupNorm:
    """GroupNorm with groups of 16 channels: no batch statistics to drift or to break weight averaging."""
    return nn.GroupNorm(channels // GROUP_SIZE, channels)


class FrozenBatchNorm(FrozenBatchNorm2d):
    """torchvision's, computed by one kernel in place of several."""

    weight: Tensor
    bias: Tensor
    running_mean: Tensor
    running_var: Tensor

    def forward(self, x: Float[Tensor, "B C h w"]) -> Float[Tensor, "B C h w"]:
        """Shift and scale each channel by what was learned before."""
        mean, var = self.running_mean, self.running_var
        return F.batch_norm(x, mean, var, self.weight, self.bias, training=False, eps=self.eps)


class FastWhenActing(nn.Module):
    """Keeps its weights channels-last in evaluation on a CPU: one image takes half the time.

    PyTorch otherwise reorders every weight in each call. In training they are stored as everyone expects.
    """

    def train(self, mode: bool = True) -> "FastWhenActing":
        """Set the mode, and the order of the weights in memory."""
        if mode != self.training:
            on_cpu = next(self.parameters()).device.type == "cpu"
            layout = torch.channels_last if on_cpu and not mode else torch.contiguous_format
            self.to(memory_format=layout)  # pyright: ignore[reportCallIssue]  (missing in its overloads)
        return super().train(mode)


class ResnetBody(FastWhenActing, nn.Sequential):
    """A ResNet up to its last feature map."""


class SmallCnn(FastWhenActing):
    """Four stride-2 convolutions for small images on a CPU: 0.39 M parameters, stride 16."""

    CHANNELS = (32, 64, 128, 256)

    def __init__(self):
        super().__init__()
        layers: list[nn.Module] = []
        for c_in, c_out in zip((3, *self.CHANNELS), self.CHANNELS, strict=False):
            layers += [
                nn.Conv2d(c_in, c_out, 3, stride=2, padding=1, bias=False),
                group_norm(c_out),
                nn.ReLU(inplace=True),
            ]
        self.layers = nn.Sequential(*layers)

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B C h w"]:
        """Feature map of 256 channels, one cell per 16 x 16 pixels."""
        return self.layers(images)


def cached_weights(backbone: str, name: str) -> WeightsEnum:
    """The torchvision weights called ``name``, if they fit ``backbone`` and are already on this machine.

    Raises:
        ConfigurationError: otherwise; a missing file is named with its folder and address.
    """
    choices = [str(weights) for weights in torchvision.models.get_model_weights(backbone)]
    if name not in choices:
        raise unknown_choice(f"pretrained_backbone_weights for {backbone}", name, choices)
    weights = torchvision.models.get_weight(name)
    folder = Path(torch.hub.get_dir()) / "checkpoints"
    file = weights.url.rsplit("/", 1)[-1]
    if not (folder / file).is_file():
        raise ConfigurationError(
            f"pretrained_backbone_weights={name} is not on this machine and nothing is downloaded for you. "
            f"Put {file} (from {weights.url}) into {folder}, or train from scratch with "
            "--policy.pretrained_backbone_weights=null"
        )
    return weights
