"""The settings of cameras, under the same names in every policy of this package."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.image_view import ImageView, Size
from lerobot_act_chunking.nn.vision import check_backbone

AUTO = "auto"
RANDOM_BACKBONE = {"vision_backbone": "resnet18"}
"""What is built where nobody chose a backbone, and ``auto`` has not chosen one with weights."""


@dataclass
class CameraFields:
    """Mixin for policy configurations: what is seen of images, and what turns them into features.

    Attributes:
        resize_shape: height and width [pixels] that the images of all cameras are resized to, in training
            and when acting; by default they stay as they are. ``[240, 320]`` is a good start for cameras of
            480 x 640. Training then reads frames that were resized once (docs/guides/frame-cache.md).
        crop_shape: height and width [pixels] of the part that is cut out of the (resized) images; by default
            all of it is seen.
        crop_is_random: training cuts out a part anywhere, drawn for each sample and camera; acting and
            evaluation always take the middle.
        vision_backbone: ``small_cnn`` for small images on a CPU, torchvision's ``resnet18``, ``resnet34``,
            ``resnet50``, ``convnext_tiny`` or ``vit_b_16``, ``efficientnet_lite0``, or ``timm:<name>``. By
            default ``resnet18``, or what ``pretrained_backbone_weights=auto`` finds weights for.
        pretrained_backbone_weights: ``auto`` takes ImageNet's where they can be had: from torch hub's cache,
            by a download unless the hub is offline, else those of ``efficientnet_lite0``, if neither
            backbone nor weights were given. What it chose is in the checkpoint. ``imagenet`` are those of
            ``efficientnet_lite0``, from a package; torchvision's have names such as
            ``ResNet18_Weights.IMAGENET1K_V1``, and lie in torch hub's cache; for timm a file. ``null``
            starts from random weights.
        backbone_norm: what replaces batch normalisation in the image backbone. Pretrained weights need
            ``frozen_batch``; without pretrained weights ``frozen_batch`` normalises nothing.
    """

    resize_shape: tuple[int, int] | None = None
    crop_shape: tuple[int, int] | None = None
    crop_is_random: bool = True
    vision_backbone: str = None  # pyright: ignore[reportAssignmentType]  (decided on construction)
    pretrained_backbone_weights: str | None = AUTO
    backbone_norm: Literal["group", "frozen_batch"] = None  # pyright: ignore[reportAssignmentType]  (likewise)

    @property
    def starts_pretrained(self) -> bool:
        """Whether the backbone starts from weights that are named, or that ``auto`` has found."""
        return self.pretrained_backbone_weights not in (None, AUTO)

    @property
    def image_view(self) -> ImageView:
        """What the policy sees of images."""
        return ImageView(_size(self.resize_shape), _size(self.crop_shape))

    @property
    def crops_at_random(self) -> bool:
        """Whether training sees another part of an image each time."""
        return self.crop_shape is not None and self.crop_is_random

    def check_backbone(self) -> None:
        """Refuse a backbone that does not exist, and weights with layers they were not trained with."""
        weights = self.pretrained_backbone_weights if self.starts_pretrained else None
        check_backbone(self.vision_backbone, weights)
        if weights is not None and self.backbone_norm != "frozen_batch":
            raise ConfigurationError(
                f"pretrained weights need another backbone_norm than {self.backbone_norm}: set "
                "--policy.backbone_norm=frozen_batch, or --policy.pretrained_backbone_weights=null"
            )
        if self.resize_shape is not None:
            self._check_crop("resize_shape", self.resize_shape)

    def check_views(self, images: Mapping[str, tuple[int, ...]]) -> None:
        """Refuse a part of the image that is larger than a camera's images.

        Args:
            images: shape (3, height, width) of each camera.

        Raises:
            ConfigurationError: naming the camera, both sizes and the way out.
        """
        if self.resize_shape is None:
            for key, shape in images.items():
                self._check_crop(f"the images of {key!r}", shape[1:])

    def _check_crop(self, what: str, size: Any) -> None:
        crop = self.crop_shape
        if crop is None or (crop[0] <= size[0] and crop[1] <= size[1]):
            return
        fitting = [min(part, whole) for part, whole in zip(crop, size, strict=True)]
        raise ConfigurationError(
            f"crop_shape={list(crop)} does not fit into {what}, of height and width {list(size)}: set "
            f"--policy.crop_shape='{fitting}' or less"
        )


def _size(shape: Any) -> Size | None:
    """A shape that may come from JSON, which has no tuples."""
    return None if shape is None else (shape[0], shape[1])
