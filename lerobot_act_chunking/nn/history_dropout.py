"""Training without the past, so that a policy does not only copy what it did."""

from collections.abc import Mapping

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from lerobot_act_chunking.nn.processes import draw_rows


def history_dropout_mask(
    n_samples: int, probability: float, generator: torch.Generator
) -> Bool[Tensor, " B"]:
    """The samples of a batch whose past is dropped, each with ``probability``; on the generator's device."""
    drawn = draw_rows(torch.rand, (n_samples,), generator=generator, device=generator.device)
    return drawn < probability


def drop_history(
    observations: Mapping[str, Float[Tensor, "B H ..."]], forget: Bool[Tensor, " B"]
) -> dict[str, Float[Tensor, "B H ..."]]:
    """Observations of samples that ``forget`` replaced by their current one, as at an episode's start.

    A policy that sees the past learns to repeat its last motion rather than to look (causal confusion, de
    Haan et al. 2019). One that must often do without learns what the current observation alone says. All
    observations of a sample lose their past together.

    Args:
        observations: of the last H steps, the current one last.
        forget: one flag per sample.
    """
    return {key: _without_past(value, forget) for key, value in observations.items()}


def _without_past(value: Float[Tensor, "B H ..."], forget: Bool[Tensor, " B"]) -> Float[Tensor, "B H ..."]:
    rows = forget.to(value.device).reshape(-1, *[1] * (value.ndim - 1))
    return torch.where(rows, value[:, -1:], value)
