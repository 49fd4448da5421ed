"""Image backbones: what turns a camera image into a feature map."""

from lerobot_act_chunking.nn.vision.backbones import check_backbone, make_backbone

__all__ = ["check_backbone", "make_backbone"]
