"""What was observed, as a denoiser is conditioned on it: one vector, or tokens to attend to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.observation import CameraTokens, VectorTokens

COLOURS = 3


@dataclass(frozen=True)
class Condition:
    """One of the two.

    Attributes:
        vector: (B, G), everything observed.
        tokens: (B, N, D), with their positions.
    """

    vector: Float[Tensor, "B G"] | None = None
    tokens: Float[Tensor, "B N D"] | None = None


class NullFeatures(nn.Module):
    """Learned stand-ins for inputs that guidance may leave out: vectors for vectors, one colour for an image.

    Source: classifier-free guidance (Ho and Salimans 2022).

    Args:
        keys: inputs that may be left out.
        vector_dims: sizes of all vectors.
        image_keys: all cameras.

    Raises:
        ConfigurationError: for a key that is no input.
    """

    def __init__(self, keys: Sequence[str], vector_dims: Mapping[str, int], image_keys: Sequence[str]):
        super().__init__()
        shapes = {key: (n,) for key, n in vector_dims.items()} | dict.fromkeys(image_keys, (COLOURS, 1, 1))
        for key in keys:
            if key not in shapes:
                raise ConfigurationError(f"null_features has {key!r}; the inputs are: {', '.join(shapes)}")
        self.keys = tuple(keys)
        self.values = nn.ParameterList(torch.zeros(shapes[key]) for key in keys)

    def forward(
        self, inputs: Mapping[str, Float[Tensor, "B H ..."]], drop: Bool[Tensor, " B"] | None
    ) -> dict[str, Float[Tensor, "B H ..."]]:
        """The inputs; rows of those that may be left out are replaced where ``drop`` is true."""
        replaced = dict(inputs)
        if drop is not None:
            for key, value in zip(self.keys, self.values, strict=True):
                if key in replaced:
                    rows = drop.reshape(-1, *[1] * (inputs[key].ndim - 1))
                    replaced[key] = torch.where(rows, value, inputs[key])
        return replaced


class CameraKeypoints(nn.Module):
    """Where in its image each camera sees what: Diffusion Policy's spatial softmax (Finn et al. 2016).

    All cameras share the backbone; those of one shape go through it in one call, with all observed steps.

    Args:
        image_shapes: (3, h, w) of each camera.
        n_keypoints: K.
        backbone: from images (n, 3, h, w) to feature maps (n, channels, h', w').
        channels: of these feature maps.
    """

    def __init__(
        self,
        image_shapes: Mapping[str, tuple[int, ...]],
        n_keypoints: int,
        backbone: nn.Module,
        channels: int,
    ):
        super().__init__()
        self.keys = tuple(image_shapes)
        by_shape: dict[tuple[int, ...], list[str]] = {}
        for key, shape in image_shapes.items():
            by_shape.setdefault(tuple(shape), []).append(key)
        self.groups = tuple(tuple(group) for group in by_shape.values())
        self.backbone = backbone
        self.attention = nn.Conv2d(channels, n_keypoints, kernel_size=1)
        self.projection = nn.Linear(2 * n_keypoints, 2 * n_keypoints)
        self.dim = 2 * n_keypoints * len(self.keys)

    def forward(self, images: Mapping[str, Float[Tensor, "B H 3 _ _"]]) -> Float[Tensor, "B H G"]:
        """Features of all cameras, in the order of the keys given at construction."""
        features = {}
        for group in self.groups:
            frames = torch.cat([images[key] for key in group])
            keypoints = spatial_softmax(self.attention(self.backbone(frames.flatten(0, 1)))).flatten(1)
            projected = self.projection(keypoints).relu().unflatten(0, frames.shape[:2])
            features |= zip(group, projected.chunk(len(group)), strict=True)
        return torch.cat([features[key] for key in self.keys], dim=-1)


def spatial_softmax(maps: Float[Tensor, "B K h w"]) -> Float[Tensor, "B K 2"]:
    """Mean position (x, y) in [-1, 1] of each map's softmax: -1 is the first column or row, 1 the last."""
    weights = maps.flatten(2).softmax(-1).reshape(maps.shape)
    y, x = (torch.linspace(-1, 1, n, dtype=maps.dtype, device=maps.device) for n in maps.shape[2:])
    return torch.stack((weights.sum(2) @ x, weights.sum(3) @ y), dim=-1)


class ConditionVector(nn.Module):
    """All observations of all steps, end to end: step by step, vectors before cameras.

    Args:
        vector_dims: sizes of the vectors, in their order.
        n_obs_steps: H.
        cameras: keypoints of the images, if there are any.
        null_features: inputs that guidance may leave out.

    Attributes:
        dim: G.
    """

    def __init__(
        self,
        vector_dims: Mapping[str, int],
        n_obs_steps: int,
        cameras: CameraKeypoints | None = None,
        null_features: Sequence[str] = (),
    ):
        super().__init__()
        self.keys = tuple(vector_dims)
        self.cameras = cameras
        self.null = NullFeatures(null_features, vector_dims, () if cameras is None else cameras.keys)
        self.dim = n_obs_steps * (sum(vector_dims.values()) + (0 if cameras is None else cameras.dim))

    def forward(
        self,
        vectors: Mapping[str, Float[Tensor, "B H _"]],
        images: Mapping[str, Float[Tensor, "B H 3 _ _"]],
        drop: Bool[Tensor, " B"] | None = None,
    ) -> Condition:
        """The vector of each sample; inputs that may be left out are, where ``drop`` is true."""
        vectors = self.null(vectors, drop)
        parts = [vectors[key] for key in self.keys]
        if self.cameras is not None:
            parts.append(self.cameras(self.null(images, drop)))
        return Condition(vector=torch.cat(parts, dim=-1).flatten(1))


class ConditionTokens(nn.Module):
    """One token for each vector and for each cell of each camera's feature map, at each observed step.

    Args:
        vector_dims: sizes of the vectors.
        n_obs_steps: H.
        cameras: tokens of the images, if there are any.
        dim: token width D.
        null_features: inputs that guidance may leave out.

    Attributes:
        dim: D.
    """

    def __init__(
        self,
        vector_dims: Mapping[str, int],
        n_obs_steps: int,
        cameras: CameraTokens | None,
        dim: int,
        null_features: Sequence[str] = (),
    ):
        super().__init__()
        self.dim = dim
        self.vectors = VectorTokens(vector_dims, dim) if vector_dims else None
        self.cameras = cameras
        self.null = NullFeatures(null_features, vector_dims, () if cameras is None else cameras.keys)
        self.steps = nn.Parameter(0.02 * torch.randn(n_obs_steps, 1, dim))

    def forward(
        self,
        vectors: Mapping[str, Float[Tensor, "B H _"]],
        images: Mapping[str, Float[Tensor, "B H 3 _ _"]],
        drop: Bool[Tensor, " B"] | None = None,
    ) -> Condition:
        """Tokens, step by step vectors before cameras; ``drop`` as in `ConditionVector`."""
        tokens = []
        if self.vectors is not None:
            tokens.append(self.vectors(_frames(self.null(vectors, drop))) + self.vectors.positions)
        if self.cameras is not None:
            cells, positions = self.cameras(_frames(self.null(images, drop)))
            tokens.append(cells + positions)
        of_frames = torch.cat(tokens, dim=1)  # (B * H, n, D)
        return Condition(tokens=(of_frames.unflatten(0, (-1, len(self.steps))) + self.steps).flatten(1, 2))


def _frames(inputs: Mapping[str, Float[Tensor, "B H ..."]]) -> dict[str, Float[Tensor, "F ..."]]:
    return {key: value.flatten(0, 1) for key, value in inputs.items()}
