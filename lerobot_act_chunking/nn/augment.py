"""Random shifts of training images."""

from functools import partial

import torch
from jaxtyping import Float, Int64, Shaped
from torch import Tensor

from lerobot_act_chunking.nn.processes import draw_rows


def random_shift(
    images: Float[Tensor, "B *H 3 h w"], max_shift: int, generator: torch.Generator
) -> Float[Tensor, "B *H 3 h w"]:
    """Images moved by up to ``max_shift`` whole pixels each way; the border is repeated into what opens.

    All steps of a sample move alike, so that what moves in the world still does (DrQ, Yarats et al. 2021,
    section 3.1).

    Args:
        images: of one step or of several.
        max_shift: in pixels.
        generator: of the shifts, on the device of ``images``.
    """
    height, width = images.shape[-2:]
    rows, columns = (_sources(len(images), n, max_shift, generator) for n in (height, width))
    return take_pixels(images, rows, columns)


def take_pixels(
    images: Shaped[Tensor, "B *H 3 _ _"], rows: Int64[Tensor, "B h"], columns: Int64[Tensor, "B w"]
) -> Shaped[Tensor, "B *H 3 h w"]:
    """Of each sample's images these rows and columns."""
    batch = torch.arange(len(images), device=images.device)[:, None, None]
    taken = images.flatten(1, -3)[batch, :, rows[:, :, None], columns[:, None, :]]  # (B, h, w, C)
    return taken.movedim(-1, 1).reshape(*images.shape[:-2], rows.shape[1], columns.shape[1])


def _sources(n_samples: int, size: int, max_shift: int, generator: torch.Generator) -> Tensor:
    """For each sample the source of every row or column (B, size)."""
    device = generator.device
    draw = partial(torch.randint, -max_shift, max_shift + 1)
    shift = draw_rows(draw, (n_samples, 1), generator=generator, device=device)
    return (torch.arange(size, device=device) + shift).clamp(0, size - 1)
