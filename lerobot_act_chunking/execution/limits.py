"""What is executed stays within ranges and speeds; what that changes is counted."""

import logging
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.execution.timeline import Environments

logger = logging.getLogger(__name__)


class ActionLimits:
    """Holds executed actions within a range, and within a change from one control step to the next.

    The first action of a rollout has no predecessor: its change is not limited. Actions within the limits are
    returned as they are, to the bit.

    Args:
        names: of the A dimensions.
        low: least value of each, in the units of the demonstrations; -inf for none.
        high: greatest value, likewise.
        change: largest change; inf for none.
        scale: of a normalised action's units in those of the demonstrations.
        offset: what a normalised 0 is.

    Attributes:
        n_actions: actions that were looked at.
        beyond_range: how often each dimension (A,) was held within the range.
        too_fast: how often within the change.
    """

    def __init__(
        self,
        names: Sequence[str],
        *,
        low: Float[Tensor, " A"],
        high: Float[Tensor, " A"],
        change: Float[Tensor, " A"],
        scale: Float[Tensor, " A"],
        offset: Float[Tensor, " A"],
    ):
        self.names = list(names)
        self._limits, self._units = (low, high, change), (scale, offset)
        self.n_actions = 0
        self.beyond_range = torch.zeros(len(names), dtype=torch.int64)
        self.too_fast = torch.zeros(len(names), dtype=torch.int64)
        self._last: Tensor | None = None

    def reset(self, envs: Environments = None) -> None:
        """A rollout begins in these environments; None: in all. Counts go on."""
        if envs is None:
            self._last = None
        elif self._last is not None:
            self._last[envs.to(self._last.device)] = torch.nan

    def __call__(self, actions: Float[Tensor, "B A"]) -> Float[Tensor, "B A"]:
        """The actions of this control step that may be executed, in the units of the demonstrations."""
        low, high, change = (each.to(actions) for each in self._limits)
        if self._last is None or self._last.shape != actions.shape:
            self._last = torch.full_like(actions, torch.nan)
        in_range = actions.clamp(low, high)
        executed = torch.fmin(torch.fmax(in_range, self._last - change), self._last + change)
        self._count(actions, in_range, executed)
        self._last = executed.clone()
        return executed

    def normalised(self, actions: Float[Tensor, "B A"]) -> Float[Tensor, "B A"]:
        """As a call, of actions in the units of a policy."""
        scale, offset = (each.to(actions) for each in self._units)
        asked = actions * scale + offset
        executed = self(asked)
        return torch.where(executed == asked, actions, (executed - offset) / scale)

    def _count(self, asked: Tensor, in_range: Tensor, executed: Tensor) -> None:
        self.n_actions += len(asked)
        if torch.equal(asked, executed):
            return
        first = not self.summary
        self.beyond_range += (asked != in_range).sum(0).cpu()
        self.too_fast += (in_range != executed).sum(0).cpu()
        if first:
            logger.warning("limits hold back what the policy asks for: %s; the sum follows", self.summary)

    @property
    def summary(self) -> str:
        """Which dimensions were held back, and how often; empty if none was."""
        told = []
        for counts, why in ((self.beyond_range, "beyond the range"), (self.too_fast, "too fast")):
            told += [
                f"{name} {n} times {why}" for name, n in zip(self.names, counts.tolist(), strict=True) if n
            ]
        return ", ".join(told)

    def report(self) -> None:
        """Log what was held back in all, if anything was executed."""
        if self.n_actions:
            held = f"held back {self.summary}" if self.summary else "held nothing back"
            level = logging.WARNING if self.summary else logging.INFO
            logger.log(level, "limits %s, in %d actions", held, self.n_actions)
