"""From named vectors and camera images to one sequence of tokens."""

from collections.abc import Mapping

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.positions import ImagePositions
from lerobot_act_chunking.nn.velocity import FiniteDifferences

Tokens = tuple[Float[Tensor, "B N D"], Float[Tensor, "N D"]]


class VectorTokens(nn.Module):
    """One token for each low-dimensional observation, so that attention can weigh or ignore it."""

    def __init__(self, vector_dims: Mapping[str, int], dim: int):
        super().__init__()
        self.keys = tuple(vector_dims)
        self.dim = dim
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
        self.dim = dim
        by_shape: dict[tuple[int, ...], list[str]] = {}
        for key, shape in image_shapes.items():
            by_shape.setdefault(tuple(shape), []).append(key)
        self.groups = tuple(tuple(group) for group in by_shape.values())
        self.backbone = backbone
        self.projection = nn.Linear(channels, dim)
        self.cell_positions = ImagePositions(dim)
        self.identities = nn.Parameter(torch.zeros(len(self.keys), dim))

    def image_features(
        self, images: Mapping[str, Float[Tensor, "B *H 3 _ _"]]
    ) -> dict[str, Float[Tensor, "B *H C _ _"]]:
        """Feature maps of all cameras, of one step or of several."""
        maps = {}
        for group in self.groups:
            frames = torch.stack([images[key] for key in group])
            features = self.backbone(frames.flatten(0, -4)).unflatten(0, frames.shape[:-3])
            maps |= zip(group, features, strict=True)
        return maps

    def tokens_from_features(self, maps: Mapping[str, Float[Tensor, "B C _ _"]]) -> Tokens:
        """Tokens of feature maps and their positions, camera by camera, those of one shape side by side."""
        tokens, positions = [], []
        for key in (key for group in self.groups for key in group):
            tokens.append(self.projection(maps[key].flatten(2).transpose(1, 2)))
            place = self.cell_positions(*maps[key].shape[-2:], like=self.identities)
            positions.append(place + self.identities[self.keys.index(key)])
        return torch.cat(tokens, dim=1), torch.cat(positions)

    def forward(self, images: Mapping[str, Float[Tensor, "B 3 _ _"]]) -> Tokens:
        """Tokens of one step's images and their positions."""
        return self.tokens_from_features(self.image_features(images))


class ObservationEncoder(nn.Module):
    """All observations of the last H steps as tokens with positions. Either kind may be absent, not both.

    With H = 1 these are a token per vector and one per cell of each feature map. Each earlier step adds a
    token per vector and a coarser look at every camera. Positions of different steps differ by a learned
    addition that starts at zero.

    Args:
        vectors: tokens of the vectors.
        cameras: tokens of the images.
        n_obs_steps: H.
        differences: velocities of vectors, which become one more token each from the second step on.
        history_image_grid: rows and columns of cells to which feature maps of earlier steps are averaged.
    """

    def __init__(
        self,
        vectors: VectorTokens | None,
        cameras: CameraTokens | None,
        n_obs_steps: int = 1,
        differences: FiniteDifferences | None = None,
        history_image_grid: int = 1,
    ):
        super().__init__()
        self.vectors = vectors
        self.cameras = cameras
        self.n_obs_steps = n_obs_steps
        self.history_image_grid = history_image_grid
        dim = next(part.dim for part in (vectors, cameras) if part is not None)
        self.differences = differences
        self.velocities = None if differences is None else VectorTokens(differences.dims, dim)
        self.time = nn.Parameter(torch.zeros(n_obs_steps, 1, dim)) if n_obs_steps > 1 else None

    @property
    def n_vector_tokens(self) -> int:
        """Tokens of vectors and velocities, which stand before the first camera's."""
        n_vectors = 0 if self.vectors is None else len(self.vectors.keys)
        n_velocities = 0 if self.velocities is None else len(self.velocities.keys)
        return n_vectors * self.n_obs_steps + n_velocities * (self.n_obs_steps - 1)

    def image_features(
        self, images: Mapping[str, Float[Tensor, "B *H 3 _ _"]]
    ) -> dict[str, Float[Tensor, "B *H C _ _"]]:
        """Feature maps of the images; `forward` takes them in place of the images."""
        return {} if self.cameras is None else self.cameras.image_features(images)

    def forward(
        self,
        vectors: Mapping[str, Float[Tensor, "B H ..."]],
        images: Mapping[str, Float[Tensor, "B H 3 _ _"]],
    ) -> Tokens:
        """Tokens and their positions: vectors and velocities step by step, current images, earlier images.

        Args:
            vectors: of the observed steps, oldest first; without images, also the cameras' feature maps
                (see `image_features`).
            images: of the observed steps, oldest first.
        """
        parts = []
        if self.vectors is not None:
            parts.append(self._over_time(self.vectors, {key: vectors[key] for key in self.vectors.keys}))
        if self.velocities is not None and self.differences is not None:
            parts.append(self._over_time(self.velocities, self.differences(vectors)))
        if self.cameras is not None:
            seen = self.cameras.image_features(images) if images else vectors
            parts += self._read_images(self.cameras, {key: seen[key] for key in self.cameras.keys})
        tokens, positions = zip(*parts, strict=True)
        return torch.cat(tokens, dim=1), torch.cat(positions)

    def _over_time(self, reader: VectorTokens, vectors: Mapping[str, Float[Tensor, "B h _"]]) -> Tokens:
        """Tokens of the latest steps, step by step."""
        n_steps = next(iter(vectors.values())).shape[1]
        tokens = reader({key: value.flatten(0, 1) for key, value in vectors.items()})
        tokens = tokens.unflatten(0, (-1, n_steps)).flatten(1, 2)
        return tokens, self._at(slice(-n_steps, None), reader.positions)

    def _at(self, steps: slice, positions: Float[Tensor, "n D"]) -> Float[Tensor, "N D"]:
        """Positions at each of these steps, step by step."""
        return positions if self.time is None else (self.time[steps] + positions).flatten(0, 1)

    def _read_images(
        self, cameras: CameraTokens, maps: Mapping[str, Float[Tensor, "B H C _ _"]]
    ) -> list[Tokens]:
        tokens, positions = cameras.tokens_from_features({key: value[:, -1] for key, value in maps.items()})
        now = tokens, self._at(slice(-1, None), positions)
        if self.n_obs_steps == 1:
            return [now]
        earlier = {key: self._coarse(value[:, :-1].flatten(0, 1)) for key, value in maps.items()}
        tokens, positions = cameras.tokens_from_features(earlier)
        tokens = tokens.unflatten(0, (-1, self.n_obs_steps - 1)).flatten(1, 2)
        return [now, (tokens, self._at(slice(None, -1), positions))]

    def _coarse(self, maps: Float[Tensor, "F C h w"]) -> Float[Tensor, "F C r c"]:
        rows, columns = (min(n, self.history_image_grid) for n in maps.shape[-2:])
        return F.adaptive_avg_pool2d(maps, (rows, columns))
