"""Every backbone by its name."""

from torch import nn

from lerobot_act_chunking.errors import ConfigurationError, need, unknown_choice
from lerobot_act_chunking.nn.vision import timm_models, torchvision_models
from lerobot_act_chunking.nn.vision.layers import BackboneNorm
from lerobot_act_chunking.nn.vision.small_cnn import SmallCnn

SMALL_CNN = "small_cnn"
NAMES = (SMALL_CNN, *torchvision_models.NAMES, timm_models.LITE)


def check_backbone(name: str, weights: str | None) -> None:
    """Refuse a backbone that does not exist, without building it.

    Args:
        name: one of `NAMES`, or ``timm:`` and a name of timm's.
        weights: pretrained weights asked for.

    Raises:
        ConfigurationError: naming what there is, or what to install.
    """
    if name.startswith(timm_models.PREFIX):
        timm_models.check_timm(name.removeprefix(timm_models.PREFIX))
    elif name not in NAMES:
        raise unknown_choice("vision_backbone", name, (*NAMES, "timm:<name of a timm model>"))
    if name == timm_models.LITE:
        need("timm", f"vision_backbone={name}", timm_models.VISION)
    if name == SMALL_CNN and weights is not None:
        raise ConfigurationError(
            f"pretrained_backbone_weights={weights}: there are none for vision_backbone={SMALL_CNN}: set "
            "pretrained_backbone_weights=null"
        )


def make_backbone(name: str, norm: BackboneNorm, weights: str | None) -> tuple[nn.Module, int]:
    """A backbone from images (B, 3, H, W) to feature maps (B, C, h, w), and its channels C.

    Args:
        name: `SmallCnn` (stride 16), a torchvision ResNet, ConvNeXt or ViT, ``efficientnet_lite0``, or
            ``timm:`` and a name of timm's, without pooling and classifier.
        norm: in place of BatchNorm: GroupNorm, to train from scratch, or BatchNorm with frozen statistics,
            for pretrained weights. Backbones with other normalisations keep theirs.
        weights: None to start from scratch. Else of torchvision, a name such as
            ``ResNet18_Weights.IMAGENET1K_V1``, in torch hub's cache; of ``efficientnet_lite0``, ``imagenet``,
            from a package; of timm, a file. Nothing is ever downloaded.

    Raises:
        ConfigurationError: for a backbone or weights that do not exist, fit, or lie on this machine.
    """
    check_backbone(name, weights)
    if name == SMALL_CNN:
        return SmallCnn(), SmallCnn.CHANNELS[-1]
    if name == timm_models.LITE:
        return timm_models.make_efficientnet_lite0(norm, weights)
    if name.startswith(timm_models.PREFIX):
        return timm_models.make_timm_backbone(name.removeprefix(timm_models.PREFIX), norm, weights)
    return torchvision_models.make_torchvision_backbone(name, norm, weights)
