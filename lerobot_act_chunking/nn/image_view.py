"""What a policy sees of a camera's image: all of it at another size, or a part."""

from dataclasses import dataclass
from functools import partial

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Shaped
from torch import Tensor

from lerobot_act_chunking.nn.augment import take_pixels
from lerobot_act_chunking.nn.processes import draw_rows

Size = tuple[int, int]


@dataclass(frozen=True)
class ImageView:
    """How images are resized, then cropped; by default neither.

    Attributes:
        resize_shape: (height, width) that all images get.
        crop_shape: (height, width) of the part that is seen.
    """

    resize_shape: Size | None = None
    crop_shape: Size | None = None

    def resized_shape(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        """Shape (3, h, w) of a camera's images after resizing."""
        return shape if self.resize_shape is None else (shape[0], *self.resize_shape)

    def seen_shape(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        """Shape (3, h, w) of what is seen of a camera's images."""
        return self.resized_shape(shape) if self.crop_shape is None else (shape[0], *self.crop_shape)

    def __call__(
        self, images: Shaped[Tensor, "B *H 3 _ _"], generator: torch.Generator | None = None
    ) -> Shaped[Tensor, "B *H 3 _ _"]:
        """What is seen of a batch of images.

        Args:
            images: of one step or of several.
            generator: draws each sample's part, on the device of ``images``; by default it is the middle.
        """
        if self.resize_shape is not None:
            images = resize(images, self.resize_shape)
        if self.crop_shape is None:
            return images
        if generator is None:
            return center_crop(images, self.crop_shape)
        return random_crop(images, self.crop_shape, generator)


def resize(images: Shaped[Tensor, "*N 3 _ _"], size: Size) -> Shaped[Tensor, "*N 3 _ _"]:
    """Images of another size: torch's antialiased bilinear interpolation, which torchvision takes, too.

    Args:
        images: numbers of any floating-point type, or uint8, which are rounded.
        size: (height, width). Images that have it stay as they are.
    """
    if tuple(images.shape[-2:]) == size:
        return images
    flat = images.reshape(-1, *images.shape[-3:])
    return F.interpolate(flat, size, mode="bilinear", antialias=True).reshape(*images.shape[:-2], *size)


def center_crop(images: Shaped[Tensor, "*N 3 _ _"], size: Size) -> Shaped[Tensor, "*N 3 _ _"]:
    """The middle of images, as torchvision's ``CenterCrop`` finds it."""
    top, left = (round((whole - part) / 2) for whole, part in zip(images.shape[-2:], size, strict=True))
    return images[..., top : top + size[0], left : left + size[1]]


def random_crop(
    images: Shaped[Tensor, "B *H 3 _ _"], size: Size, generator: torch.Generator
) -> Shaped[Tensor, "B *H 3 _ _"]:
    """A part of each sample's images, anywhere with equal probability; all of its steps are cropped alike."""
    rows, columns = (
        _range(len(images), whole, part, generator)
        for whole, part in zip(images.shape[-2:], size, strict=True)
    )
    return take_pixels(images, rows, columns)


def _range(n_samples: int, whole: int, part: int, generator: torch.Generator) -> Tensor:
    """For each sample ``part`` neighbouring rows or columns (B, part) out of ``whole``."""
    device = generator.device
    draw = partial(torch.randint, whole - part + 1)
    first = draw_rows(draw, (n_samples, 1), generator=generator, device=device)
    return first + torch.arange(part, device=device)
