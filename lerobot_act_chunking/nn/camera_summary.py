"""A whole camera image as one token that knows where everything is."""

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.observation import CameraTokens, Tokens

CHANNELS = 16


class CameraSummaries(CameraTokens):
    """One token for each camera: its feature map in 16 channels, cell after cell.

    A weight for every place learns where things are within a few hundred batches. Attention over the tokens
    of cells needs far longer, since what it adds up are contents, not places (docs/policies/pixels.md).
    """

    def __init__(
        self, image_shapes: Mapping[str, tuple[int, ...]], dim: int, backbone: nn.Module, channels: int
    ):
        super().__init__(image_shapes, dim, backbone, channels)
        self.projection = nn.Conv2d(channels, CHANNELS, kernel_size=1)
        self.summaries = nn.ModuleList(
            nn.Linear(CHANNELS * _n_cells(backbone, shape), dim) for shape in image_shapes.values()
        )

    def tokens_from_features(self, maps: Mapping[str, Float[Tensor, "B C _ _"]]) -> Tokens:
        """A token per camera in the order of the keys, and the cameras' identities."""
        cells = [self.projection(maps[key]).flatten(1) for key in self.keys]
        tokens = [summary(flat) for summary, flat in zip(self.summaries, cells, strict=True)]
        return torch.stack(tokens, dim=1), self.identities


@torch.no_grad()
def _n_cells(backbone: nn.Module, shape: tuple[int, ...]) -> int:
    """Cells of the feature map of one image."""
    return backbone(torch.zeros(1, *shape)).shape[-2:].numel()
