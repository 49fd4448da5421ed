"""Which environments are asked for something else than in the step before."""

from collections.abc import Mapping
from typing import Any

import torch.nn.functional as F  # noqa: N812
from jaxtyping import Int64
from lerobot.utils.constants import OBS_LANGUAGE_TOKENS
from torch import Tensor


class InstructionWatch:
    """Compares the tokens of each control step with those before, of any policy that reads instructions."""

    def __init__(self) -> None:
        self._last: Tensor | None = None

    def changed(self, batch: Mapping[str, Any]) -> Int64[Tensor, " n"] | None:
        """Indices of the environments whose instruction has changed; None if all go on as before.

        Args:
            batch: of this control step.
        """
        before, now = self._last, batch.get(OBS_LANGUAGE_TOKENS)
        if not isinstance(now, Tensor) or now is before:
            return None
        self._last = now
        if before is None or before.ndim != 2 or len(before) != len(now):
            return None
        longer = max(before.shape[1], now.shape[1])
        before, now = (F.pad(each, (0, longer - each.shape[1])) for each in (before, now))
        different = (before != now).any(1)
        return different.nonzero()[:, 0].cpu() if different.any() else None
