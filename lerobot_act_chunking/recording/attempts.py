"""Outcomes of consecutive seeds, in order."""

import itertools
from collections import deque
from collections.abc import Iterator, Mapping
from typing import Self

from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.recording.runners import Runner
from lerobot_act_chunking.recording.shares import ONE_WAY, ModeShares

MAX_FAILURES_IN_A_ROW = 20


class AttemptQueue(Iterator[tuple[int, bool]]):
    """Yields (seed, success) for seeds from ``first_seed`` on, up to the ``wanted``-th success.

    Attempts are asked for ahead, as many as may still be needed: none is played in vain unless one fails.
    Where episodes go several ways, seeds of a way that has all its successes are passed over, so that each
    has exactly as many as its share says.

    Args:
        runner: plays the attempts.
        known: outcomes from before an interruption; these are not played again.
        first_seed: where to begin.
        wanted: successes to yield.
        ahead: most attempts asked for and not yet yielded.
        shares: of the ways that episodes go.
    """

    def __init__(
        self,
        runner: Runner,
        known: Mapping[int, bool],
        first_seed: int,
        wanted: int,
        ahead: int,
        shares: ModeShares = ONE_WAY,
    ) -> None:
        self._runner, self._known, self._ahead, self._shares = runner, known, ahead, shares
        self._seeds = itertools.count(first_seed)
        self._pending: deque[int] = deque()
        self._missing = shares.counts(wanted)
        self._failures_in_a_row = 0
        self._refill()

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> tuple[int, bool]:
        seed = self._next_needed()
        success = self._known[seed] if seed in self._known else self._runner.succeeded(seed)
        self._missing[self._shares.mode_of(seed)] -= success
        self._failures_in_a_row = 0 if success else self._failures_in_a_row + 1
        if self._failures_in_a_row == MAX_FAILURES_IN_A_ROW:
            raise DatasetError(
                f"{MAX_FAILURES_IN_A_ROW} attempts in a row failed, up to seed {seed}; "
                "ask the expert for less noise or an easier pace"
            )
        self._refill()
        return seed, success

    def _next_needed(self) -> int:
        while any(self._missing):
            seed = self._pending.popleft()
            if self._is_missing(seed):
                return seed
            self._refill()
        raise StopIteration

    def _refill(self) -> None:
        while len(self._pending) < min(self._ahead, sum(self._missing)):
            seed = next(self._seeds)
            if not self._is_missing(seed):
                continue
            self._pending.append(seed)
            if seed not in self._known:
                self._runner.submit(seed)

    def _is_missing(self, seed: int) -> bool:
        return self._missing[self._shares.mode_of(seed)] > 0
