"""From named vectors and camera images to one sequence of tokens."""

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.positions import ImagePositions


class VectorTokens(nn.Module):
    """One token for each low-dimensional observation, so that attention can weigh or ignore it."""

    def __init__(self, vector_dims: Mapping[str, int], dim: int):
        super().__init__()
        self.keys = tuple(vector_dims)
        self.projections = nn.ModuleList(nn.Linear(n, dim) for n in vector_dims.values())
        self.positions = nn.Parameter(torch.randn(len(self.keys), dim))

    def forward(self, vectors: Mapping[str, Float[Tensor, "B _"]]) -> Float[Tensor, "B V D"]:
        """Tokens in the order of the keys given at construction."""
        tokens = [proj(vectors[key]) for key, proj in zip(self.keys, self.projections, strict=True)]
        return torch.stack(tokens, dim=1)


class CameraTokens(nn.Module):
    """One token for each cell of each camera's feature map.

    Cameras of one image shape go through the backbone in a single call. A camera's identity is a learned
    addition to its positions that starts at zero, where all cameras look alike, as in ACT.
    """

    def __init__(
        self, image_shapes: Mapping[str, tuple[int, ...]], dim: int, backbone: nn.Module, channels: int
    ):
        super().__init__()
        self.keys = tuple(image_shapes)
        by_shape: dict[tuple[int, ...], list[str]] = {}
        for key, shape in image_shapes.items():
            by_shape.setdefault(shape, []).append(key)
        self.groups = tuple(tuple(group) for group in by_shape.values())
        self.backbone = backbone
        self.projection = nn.Linear(channels, dim)
        self.cell_positions = ImagePositions(dim)
        self.identities = nn.Parameter(torch.zeros(len(self.keys), dim))

    def forward(
        self, images: Mapping[str, Float[Tensor, "B 3 _ _"]]
    ) -> tuple[Float[Tensor, "B N D"], Float[Tensor, "N D"]]:
        """Tokens and their positions, camera by camera."""
        tokens, positions = [], []
        for group in self.groups:
            features = self.backbone(torch.cat([images[key] for key in group]))
            cells = self.projection(features.flatten(2).transpose(1, 2))
            tokens += cells.chunk(len(group))
            place = self.cell_positions(*features.shape[-2:], like=self.identities)
            positions += [place + self.identities[self.keys.index(key)] for key in group]
        return torch.cat(tokens, dim=1), torch.cat(positions)


class ObservationEncoder(nn.Module):
    """All observations as tokens with positions. Either kind may be absent, not both."""

    def __init__(self, vectors: VectorTokens | None, cameras: CameraTokens | None):
        super().__init__()
        self.vectors = vectors
        self.cameras = cameras

    def forward(
        self,
        vectors: Mapping[str, Float[Tensor, "B _"]],
        images: Mapping[str, Float[Tensor, "B 3 _ _"]],
    ) -> tuple[Float[Tensor, "B N D"], Float[Tensor, "N D"]]:
        """Tokens and their positions: vectors first, then cameras."""
        tokens, positions = [], []
        if self.vectors is not None:
            tokens.append(self.vectors(vectors))
            positions.append(self.vectors.positions)
        if self.cameras is not None:
            camera_tokens, camera_positions = self.cameras(images)
            tokens.append(camera_tokens)
            positions.append(camera_positions)
        return torch.cat(tokens, dim=1), torch.cat(positions)
