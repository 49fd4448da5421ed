"""How far a measurement is, and how long it may go on."""

import time
from collections.abc import Callable
from dataclasses import dataclass

Progress = Callable[[int, int], None]
"""Called with what is done and planned so far."""


@dataclass
class Clock:
    """How far a measurement is, and whether there is time for more.

    Attributes:
        end: of the time, as ``time.monotonic`` counts.
        progress: called with what is done and planned so far.
    """

    end: float
    progress: Progress | None
    done: int = 0
    planned: int = 0

    def may_begin(self) -> bool:
        """Whether there is time to begin something."""
        return time.monotonic() < self.end

    def advance(self, *, done: int = 0, planned: int = 0) -> None:
        """Count, and show."""
        self.done, self.planned = self.done + done, self.planned + planned
        if self.progress is not None:
            self.progress(self.done, self.planned)
