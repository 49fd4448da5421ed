"""The only door from LeRobot's batch dictionaries to typed tensors."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from lerobot_act_chunking.errors import FeatureError

ACTION = "action"
ACTION_IS_PAD = "action_is_pad"


@dataclass(frozen=True)
class FeatureSpec:
    """Keys and shapes (without the batch axis) that a policy reads."""

    vectors: Mapping[str, tuple[int, ...]]
    images: Mapping[str, tuple[int, ...]]
    action: tuple[int, ...]


@dataclass(frozen=True)
class Observation:
    """Normalised observations: of the current step (B, ...), or of the last H steps (B, H, ...)."""

    vectors: dict[str, Float[Tensor, "B *H _"]]
    images: dict[str, Float[Tensor, "B *H 3 _ _"]]

    @property
    def batch_size(self) -> int:
        """Number of samples, or of environments when acting."""
        return len(next(iter((self.vectors or self.images).values())))

    def select(self, samples: Int64[Tensor, " n"]) -> "Observation":
        """The observations of these samples, in this order."""
        return Observation(
            vectors={key: value[samples.to(value.device)] for key, value in self.vectors.items()},
            images={key: value[samples.to(value.device)] for key, value in self.images.items()},
        )

    @classmethod
    def from_lerobot(cls, batch: Mapping[str, Any], spec: FeatureSpec) -> "Observation":
        """Pick the observations of ``spec``: the current step's.

        Raises:
            FeatureError: naming a key that is absent or has another shape than the policy was built for.
        """
        return cls(
            vectors={key: _take(batch, key, shape) for key, shape in spec.vectors.items()},
            images={key: _take(batch, key, shape) for key, shape in spec.images.items()},
        )

    @classmethod
    def window_from_lerobot(
        cls, batch: Mapping[str, Any], spec: FeatureSpec, n_obs_steps: int
    ) -> "Observation":
        """Pick the observations (B, n_obs_steps, ...) of ``spec``; LeRobot loads one step without the axis.

        Raises:
            FeatureError: naming a key that is absent or has another shape than the policy was built for.
        """
        if n_obs_steps == 1 and not has_time_axis(batch, spec):
            return cls.from_lerobot(batch, spec).as_window()
        return cls(
            vectors={key: _take(batch, key, (n_obs_steps, *shape)) for key, shape in spec.vectors.items()},
            images={key: _take(batch, key, (n_obs_steps, *shape)) for key, shape in spec.images.items()},
        )

    def latest(self) -> "Observation":
        """The current step's observations (B, ...) of a window."""
        return Observation(
            vectors={key: value[:, -1] for key, value in self.vectors.items()},
            images={key: value[:, -1] for key, value in self.images.items()},
        )

    def as_window(self) -> "Observation":
        """The current step's observations as a window (B, 1, ...) of one step."""
        return Observation(
            vectors={key: value[:, None] for key, value in self.vectors.items()},
            images={key: value[:, None] for key, value in self.images.items()},
        )


@dataclass(frozen=True)
class ActionTarget:
    """The demonstrated, normalised actions; ``is_pad`` marks steps behind the end of the episode."""

    actions: Float[Tensor, "B T A"]
    is_pad: Bool[Tensor, "B T"]

    @classmethod
    def from_lerobot(cls, batch: Mapping[str, Any], spec: FeatureSpec, chunk_size: int) -> "ActionTarget":
        """Pick the action chunk and its padding.

        Raises:
            FeatureError: naming a key that is absent or has another shape than the policy was built for.
        """
        return cls(
            actions=_take(batch, ACTION, (chunk_size, *spec.action)),
            is_pad=_take(batch, ACTION_IS_PAD, (chunk_size,)),
        )


def has_time_axis(batch: Mapping[str, Any], spec: FeatureSpec) -> bool:
    """Whether the observations of a batch come with a time axis (B, H, ...)."""
    key, shape = next(iter((spec.vectors or spec.images).items()))
    return isinstance(batch.get(key), Tensor) and batch[key].ndim == len(shape) + 2


def first_non_finite(batch: Mapping[str, Any]) -> str | None:
    """The first key of ``batch`` whose tensor holds a NaN or an infinity."""
    for key, value in batch.items():
        if isinstance(value, Tensor) and not torch.isfinite(value).all():
            return key
    return None


def _take(batch: Mapping[str, Any], key: str, shape: tuple[int, ...]) -> Tensor:
    value = batch.get(key)
    if value is None:
        present = ", ".join(sorted(k for k, v in batch.items() if v is not None))
        raise FeatureError(f"the policy needs {key!r}, but the batch has only: {present}")
    if value.shape[1:] != torch.Size(shape):
        raise FeatureError(
            f"{key!r} has shape {tuple(value.shape[1:])} per sample, but the policy was built for {shape}"
        )
    return value
