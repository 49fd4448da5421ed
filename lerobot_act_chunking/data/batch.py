"""LeRobot's batch dictionaries as typed tensors; all access to them goes through here."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from lerobot_act_chunking.errors import FeatureError
from lerobot_act_chunking.nn.image_view import ImageView
from lerobot_act_chunking.nn.language.text import Text

ACTION = "action"
ACTION_IS_PAD = "action_is_pad"
TOKENS, TOKENS_MASK = "observation.language.tokens", "observation.language.attention_mask"


@dataclass(frozen=True)
class FeatureSpec:
    """Keys and shapes (without the batch axis) that a policy reads, and what it sees of images.

    Attributes:
        vectors, images, action: shapes by key.
        view: what is seen of images.
        text_tokens: word pieces of the longest instruction; 0 for a policy that reads none.
    """

    vectors: Mapping[str, tuple[int, ...]]
    images: Mapping[str, tuple[int, ...]]
    action: tuple[int, ...]
    view: ImageView = field(default_factory=ImageView)
    text_tokens: int = 0

    @property
    def seen(self) -> dict[str, tuple[int, ...]]:
        """Shapes of what the policy's network gets of the images."""
        return {key: self.view.seen_shape(shape) for key, shape in self.images.items()}

    @property
    def keys(self) -> tuple[str, ...]:
        """All that training reads."""
        return (*self.vectors, *self.images, ACTION)


@dataclass(frozen=True)
class Observation:
    """Normalised observations: of the current step (B, ...), or of the last H steps (B, H, ...).

    The instruction is the current one.
    """

    vectors: dict[str, Float[Tensor, "B *H _"]]
    images: dict[str, Float[Tensor, "B *H 3 _ _"]]
    text: Text | None = None

    @property
    def batch_size(self) -> int:
        """Number of samples, or of environments when acting."""
        return len(next(iter((self.vectors or self.images).values())))

    def select(self, samples: Int64[Tensor, " n"]) -> "Observation":
        """The observations of these samples, in this order."""
        return Observation(
            vectors={key: value[samples.to(value.device)] for key, value in self.vectors.items()},
            images={key: value[samples.to(value.device)] for key, value in self.images.items()},
            text=self.text and Text(*(value[samples.to(value.device)] for value in self.text)),
        )

    @classmethod
    def from_lerobot(cls, batch: Mapping[str, Any], spec: FeatureSpec) -> "Observation":
        """Pick the observations of ``spec``: the current step's.

        Raises:
            FeatureError: naming a key that is absent or has another shape than the policy was built for.
        """
        return cls.window_from_lerobot(batch, spec, 1).latest()

    @classmethod
    def window_from_lerobot(
        cls,
        batch: Mapping[str, Any],
        spec: FeatureSpec,
        n_obs_steps: int,
        target: "ActionTarget | None" = None,
        generator: torch.Generator | None = None,
    ) -> "Observation":
        """Pick the observations (B, n_obs_steps, ...) of ``spec``; LeRobot loads one step without the axis.

        Images come as the cameras give them, or resized already (`fast_chunks`).

        Args:
            batch: LeRobot's.
            spec: what the policy reads.
            n_obs_steps: observations in the window.
            target: the actions of the same batch, in training.
            generator: draws which part of an image is seen; by default it is the middle.

        Raises:
            FeatureError: naming a key that is absent or has another shape than the policy was built for.
        """
        steps = ((n_obs_steps,), ()) if n_obs_steps == 1 else ((n_obs_steps,),)
        targets = {} if target is None else {ACTION: target.actions}
        n_targets = None if target is None else len(target.actions)
        vectors = {key: _take(batch, key, shape, steps, n_targets) for key, shape in spec.vectors.items()}
        images = {
            key: _take(batch, key, _arriving(batch, key, shape, spec.view), steps)
            for key, shape in spec.images.items()
        }
        _check_batch_sizes({**targets, **vectors, **images})
        seen = {key: spec.view(value, generator) for key, value in images.items()}
        return cls(vectors, seen, _text(batch, spec.text_tokens) if spec.text_tokens else None)

    def latest(self) -> "Observation":
        """The current step's observations (B, ...) of a window."""
        return replace(
            self,
            vectors={key: value[:, -1] for key, value in self.vectors.items()},
            images={key: value[:, -1] for key, value in self.images.items()},
        )

    def as_window(self) -> "Observation":
        """The current step's observations as a window (B, 1, ...) of one step."""
        return replace(
            self,
            vectors={key: value[:, None] for key, value in self.vectors.items()},
            images={key: value[:, None] for key, value in self.images.items()},
        )


@dataclass(frozen=True)
class ActionTarget:
    """The demonstrated, normalised actions; ``is_pad`` marks steps behind the end of the episode."""

    actions: Float[Tensor, "B T A"]
    is_pad: Bool[Tensor, "B T"]

    @classmethod
    def from_lerobot(
        cls, batch: Mapping[str, Any], spec: FeatureSpec, steps: Sequence[int]
    ) -> "ActionTarget":
        """Pick the actions of these steps and their padding.

        Args:
            batch: holds these steps alone, or every step from the first of them on.
            spec: what the policy reads.
            steps: relative to the current one, ascending (``config.action_delta_indices``).

        Raises:
            FeatureError: naming a key that is absent or has another shape than the policy was built for.
        """
        actions = _take(_at_steps(batch, ACTION, steps), ACTION, spec.action, ((len(steps),),))
        is_pad = _take(_at_steps(batch, ACTION_IS_PAD, steps), ACTION_IS_PAD, (), ((len(steps),),))
        _check_batch_sizes({ACTION: actions, ACTION_IS_PAD: is_pad})
        return cls(actions, is_pad)


def has_time_axis(batch: Mapping[str, Any], spec: FeatureSpec, n_obs_steps: int) -> bool:
    """Whether the observations of a batch come with a time axis (B, n_obs_steps, ...).

    Raises:
        FeatureError: naming two of several steps that differ in it.
    """
    with_axis = {
        key: value.ndim == len(shape) + 2 or (*value.shape[1:], 1) == (n_obs_steps, *shape)
        for key, shape in {**spec.vectors, **spec.images}.items()
        if isinstance(value := batch.get(key), Tensor)
    }
    if n_obs_steps > 1 and len(set(with_axis.values())) == 2:
        has, lacks = (next(key for key in with_axis if with_axis[key] is which) for which in (True, False))
        raise FeatureError(
            f"{has!r} has a time axis (shape {tuple(batch[has].shape)}), but {lacks!r} has none (shape "
            f"{tuple(batch[lacks].shape)}): give all inputs the last {n_obs_steps} steps, or the current one"
        )
    return any(with_axis.values())


def first_non_finite(batch: Mapping[str, Any], keys: Iterable[str]) -> str | None:
    """The first of ``keys`` whose tensor in ``batch`` holds a NaN or an infinity."""
    for key in keys:
        if not torch.isfinite(batch[key]).all():
            return key
    return None


def _at_steps(batch: Mapping[str, Any], key: str, steps: Sequence[int]) -> Mapping[str, Any]:
    """The batch with these steps alone of a key that holds every step from the first of them on."""
    value = batch.get(key)
    if not isinstance(value, Tensor) or value.ndim < 2:
        return batch
    places = [step - steps[0] for step in steps]
    if value.shape[1] == len(places) or value.shape[1] <= places[-1]:
        return batch
    return {**batch, key: value[:, places]}


def _take(
    batch: Mapping[str, Any],
    key: str,
    shape: tuple[int, ...],
    times: Sequence[tuple[int, ...]],
    n_targets: int | None = None,
) -> Tensor:
    """The value (B, *times[0], *shape) of a key that comes with any of these time axes.

    LeRobot stores a feature of one value as a scalar, so that its last axis is missing. Where that leaves
    (B,), its processors take the batch for one vector (1, B): B is then the number of targets.
    """
    value = batch.get(key)
    if value is None:
        present = ", ".join(sorted(k for k, v in batch.items() if v is not None))
        raise FeatureError(f"the policy needs {key!r}, but the batch has only: {present}")
    expected = " or ".join(_shape("B", *time, *shape) for time in reversed(times))
    if not isinstance(value, Tensor) or not value.ndim:
        what = "a number" if isinstance(value, Tensor) else f"of type {type(value).__name__}"
        raise FeatureError(f"{key!r} is {what}, but the policy was built for tensors {expected}")
    complete = [(*time, *shape) for time in times]
    accepted = complete + (list(times) if shape == (1,) else [])
    if tuple(value.shape[1:]) in accepted:
        return value.reshape(len(value), *complete[0])
    if shape == (1,) and () in times and value.shape == (1, n_targets):
        return value.reshape(-1, *complete[0])
    alone = tuple(value.shape) == shape
    raise FeatureError(
        f"{key!r} has shape {tuple(value.shape)}, but the policy was built for {expected}, B samples"
        + (": give a single one a batch axis, with unsqueeze(0)" if alone else "")
    )


def _arriving(batch: Mapping[str, Any], key: str, shape: tuple[int, ...], view: ImageView) -> tuple[int, ...]:
    """The shape in which a camera's images come: the camera's, or what it is resized to."""
    value, resized = batch.get(key), view.resized_shape(shape)
    is_resized = isinstance(value, Tensor) and tuple(value.shape[-len(resized) :]) == resized
    return resized if is_resized else shape


def _text(batch: Mapping[str, Any], most: int) -> Text:
    """The instructions of a batch."""
    tokens, mask = batch.get(TOKENS), batch.get(TOKENS_MASK)
    if tokens is None or mask is None:
        missing = TOKENS if tokens is None else TOKENS_MASK
        raise FeatureError(
            f"the policy reads instructions, but the batch has no {missing!r}: give each sample its task as "
            "tokens (B, L), [CLS] and [SEP] included, or train with --policy.encoder_vocabulary=0"
        )
    if tokens.ndim != 2 or tokens.shape != mask.shape:
        raise FeatureError(
            f"{TOKENS!r} has shape {tuple(tokens.shape)} and {TOKENS_MASK!r} {tuple(mask.shape)}, but the "
            "policy was built for (B, L), B samples"
        )
    longest = int(mask.sum(1).max())
    if longest > most:
        raise FeatureError(
            f"an instruction has {longest} tokens, more than encoder_text_tokens={most}: shorten it, or "
            f"train with --policy.encoder_text_tokens={longest}"
        )
    return Text(tokens[:, :most], ~mask.bool()[:, :most])


def _shape(*sizes: int | str) -> str:
    return f"({', '.join(map(str, sizes))}{',' * (len(sizes) == 1)})"


def _check_batch_sizes(values: Mapping[str, Tensor]) -> None:
    (first, value), *others = values.items()
    for key, other in others:
        if len(other) != len(value):
            raise FeatureError(
                f"{key!r} has {len(other)} samples (shape {tuple(other.shape)}), but {first!r} has "
                f"{len(value)}: all inputs of a batch have the same number"
            )
