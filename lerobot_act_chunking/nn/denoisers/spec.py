"""Everything that a denoiser is built from."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

from torch import nn


@dataclass(frozen=True, kw_only=True)
class DenoiserSpec:
    """How noisy actions are denoised. Only the settings of the named denoiser count.

    Attributes:
        denoiser: ``mixer``, ``dit`` or ``unet1d``.
        horizon: T, actions per chunk.
        actions_per_token: consecutive actions that make a token of ``mixer`` and ``dit``.
        dim_model: token width of ``mixer`` and ``dit``.
        n_layers: layers of ``mixer`` and ``dit``.
        n_heads: attention heads of ``dit``.
        dropout: dropout probability in ``mixer`` and ``dit``.
        down_dims: channels of ``unet1d`` at each resolution.
        kernel_size: of the convolutions of ``unet1d``.
        n_groups: of the group normalisation of ``unet1d``.
        diffusion_step_embed_dim: width of the time embedding of ``unet1d``.
        use_film_scale_modulation: let the condition scale the features of ``unet1d``, not only shift them.
    """

    denoiser: str
    horizon: int
    actions_per_token: int
    dim_model: int
    n_layers: int
    n_heads: int
    dropout: float
    down_dims: Sequence[int]
    kernel_size: int
    n_groups: int
    diffusion_step_embed_dim: int
    use_film_scale_modulation: bool

    @classmethod
    def from_fields(cls, source: Any) -> "DenoiserSpec":
        """The spec whose values are the attributes of ``source``, a policy's configuration."""
        return cls(**{field.name: getattr(source, field.name) for field in fields(cls)})


@dataclass(frozen=True)
class DenoiserInputs:
    """What comes in beside the noisy actions.

    Attributes:
        action_dim: A.
        condition_dim: size of the condition vector, or width of the condition tokens.
        time_embedding: makes the embedding of the time, of a given width.
    """

    action_dim: int
    condition_dim: int
    time_embedding: Callable[[int], nn.Module]
