"""What is executed stays within ranges and speeds; what that changes is counted."""

import logging
from collections.abc import Sequence

import numpy as np

from act_chunking_runtime.timeline import Environments

logger = logging.getLogger(__name__)


class ActionLimits:
    """Holds executed actions within a range, and within a change from one control step to the next.

    The first action of a rollout has no predecessor: its change is not limited. Actions within the limits are
    returned as they are, to the bit.

    Args:
        names: of the A dimensions.
        low: least value of each (A,), in the units of the demonstrations; -inf for none.
        high: greatest value, likewise.
        change: largest change; inf for none.
        scale: of a normalised action's units in those of the demonstrations.
        offset: what a normalised 0 is.

    Attributes:
        bounds: ``low``, ``high`` and ``change``.
        n_actions: actions that were looked at.
        beyond_range: how often each dimension (A,) was held within the range.
        too_fast: how often within the change.
    """

    def __init__(
        self,
        names: Sequence[str],
        *,
        low: np.ndarray,
        high: np.ndarray,
        change: np.ndarray,
        scale: np.ndarray,
        offset: np.ndarray,
    ):
        self.names = list(names)
        self.bounds, self._units = (low, high, change), (scale, offset)
        self.n_actions = 0
        self.beyond_range = np.zeros(len(names), dtype=np.int64)
        self.too_fast = np.zeros(len(names), dtype=np.int64)
        self._last: np.ndarray | None = None

    def reset(self, envs: Environments = None) -> None:
        """A rollout begins in these environments; None: in all. Counts go on."""
        if envs is None:
            self._last = None
        elif self._last is not None:
            self._last[envs] = np.nan

    def hold(self, actions: np.ndarray) -> np.ndarray:
        """The actions (B, A) of this step that may be executed, in the units of the demonstrations."""
        low, high, change = (each.astype(actions.dtype) for each in self.bounds)
        if self._last is None or self._last.shape != actions.shape:
            self._last = np.full_like(actions, np.nan)
        in_range = actions.clip(low, high)
        executed = np.fmin(np.fmax(in_range, self._last - change), self._last + change)
        self._count(actions, in_range, executed)
        self._last = executed.copy()
        return executed

    def hold_normalised(self, actions: np.ndarray) -> np.ndarray:
        """As `hold`, of actions in the units of a policy."""
        scale, offset = (each.astype(actions.dtype) for each in self._units)
        asked = actions * scale + offset
        executed = self.hold(asked)
        return np.where(executed == asked, actions, (executed - offset) / scale)

    def _count(self, asked: np.ndarray, in_range: np.ndarray, executed: np.ndarray) -> None:
        self.n_actions += len(asked)
        if np.array_equal(asked, executed):
            return
        first = not self.summary
        self.beyond_range += (asked != in_range).sum(0)
        self.too_fast += (in_range != executed).sum(0)
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
