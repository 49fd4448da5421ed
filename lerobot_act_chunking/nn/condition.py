"""What was observed, as a denoiser is conditioned on it: one vector, or tokens to attend to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn


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
    """Learned values in place of vectors that guidance may leave out (classifier-free guidance)."""

    def __init__(self, dims: Mapping[str, int]):
        super().__init__()
        self.keys = tuple(dims)
        self.values = nn.ParameterList(torch.zeros(n) for n in dims.values())

    def forward(
        self, vectors: Mapping[str, Float[Tensor, "B H _"]], drop: Bool[Tensor, " B"] | None
    ) -> dict[str, Float[Tensor, "B H _"]]:
        """The vectors, replaced where ``drop`` says so."""
        replaced = dict(vectors)
        if drop is not None:
            for key, value in zip(self.keys, self.values, strict=True):
                replaced[key] = torch.where(drop[:, None, None], value, vectors[key])
        return replaced


class ConditionVector(nn.Module):
    """All observations of all steps, end to end: step by step the state, the cameras, the environment state.

    Args:
        vector_dims: sizes of the vectors, the environment state last.
        n_obs_steps: H.
        cameras: keypoints of the images, if there are any.
        null_features: vectors that may be left out.
    """

    def __init__(
        self,
        vector_dims: Mapping[str, int],
        n_obs_steps: int,
        cameras: nn.Module | None = None,
        null_features: Sequence[str] = (),
    ):
        super().__init__()
        self.keys = tuple(vector_dims)
        self.cameras = cameras
        self.null = NullFeatures({key: vector_dims[key] for key in null_features})
        self.dim = n_obs_steps * sum(vector_dims.values())

    def forward(
        self,
        vectors: Mapping[str, Float[Tensor, "B H _"]],
        images: Mapping[str, Float[Tensor, "B H 3 _ _"]],
        drop: Bool[Tensor, " B"] | None = None,
    ) -> Condition:
        """The vector of each sample; features that may be left out are, where ``drop`` says so."""
        vectors = self.null(vectors, drop)
        return Condition(vector=torch.cat([vectors[key] for key in self.keys], dim=-1).flatten(1))
