"""The observations of several steps as tokens."""

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.condition import CameraKeypoints


class HistoryTokens(nn.Module):
    """One token for each camera and one for each vector, at every observed step.

    Args:
        vector_dims: sizes of the vectors.
        cameras: keypoints of the images, if there are any.
        dim: token width D.

    Attributes:
        n_tokens: per step.
    """

    def __init__(self, vector_dims: Mapping[str, int], cameras: CameraKeypoints | None, dim: int):
        super().__init__()
        self.keys = tuple(vector_dims)
        self.vectors = nn.ModuleList(nn.Linear(n, dim) for n in vector_dims.values())
        self.cameras = cameras
        self.n_cameras = 0 if cameras is None else len(cameras.keys)
        self.images = None if cameras is None else nn.Linear(cameras.dim // self.n_cameras, dim)
        self.n_tokens = self.n_cameras + len(self.keys)

    def image_features(
        self, images: Mapping[str, Float[Tensor, "B H 3 _ _"]]
    ) -> dict[str, Float[Tensor, "B H F"]]:
        """One feature vector for each image; `forward` takes them in place of the images."""
        if self.cameras is None:
            return {}
        features = self.cameras(images).unflatten(-1, (self.n_cameras, -1))
        return dict(zip(self.cameras.keys, features.unbind(2), strict=True))

    def forward(
        self, vectors: Mapping[str, Float[Tensor, "B H _"]], images: Mapping[str, Float[Tensor, "B H 3 _ _"]]
    ) -> Float[Tensor, "B H n D"]:
        """Tokens of each step: cameras, then vectors, in the order of the keys given at construction.

        Args:
            vectors: of the observed steps; without images, also the cameras' features (see `image_features`).
            images: of the observed steps.
        """
        tokens = [project(vectors[key]) for key, project in zip(self.keys, self.vectors, strict=True)]
        if self.cameras is not None and self.images is not None:
            seen = self.image_features(images) if images else vectors
            tokens = [*(self.images(seen[key]) for key in self.cameras.keys), *tokens]
        return torch.stack(tokens, dim=2)
