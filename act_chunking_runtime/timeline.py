"""Plans over the coming steps: what to do where several chunks cover the same step."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

Environments = np.ndarray | None  # (n,) indices; None: all of them
Rows = np.ndarray  # (r, T), one row for all environments, or one for each

EMPTY = 1e300  # share of the newest prediction in a cell without any
NO_RHYTHM = (0, -1)  # steps elapsed since the last chunk, delay
MAX_EXPONENT = math.log(1e100)  # far above any share that still counts, far below EMPTY


class Timeline(ABC):
    """One cell per coming step, each holding a blend of the predictions for it; environments in lockstep.

    Cells for three windows are kept, a window being the last action and the T steps from now on, and the
    window moves over the last two of them, so that every operation is on one contiguous slice and the last T
    steps are still there for a chunk that comes late; memory is O(T) per environment whatever the number of
    overlapping chunks. What a cell has seen is told by the share that its newest prediction has in it, with
    one row for all environments until one is treated alone.

    Args:
        n_action_steps: T, the used part of each chunk [control steps].
        gripper_dims: action dimensions that follow the newest chunk alone.
    """

    def __init__(self, n_action_steps: int, gripper_dims: Sequence[int] = ()):
        self.n_action_steps = n_action_steps
        self._span = n_action_steps + 1
        self._held_dims = list(gripper_dims)
        self.reset()

    @abstractmethod
    def _mix(self, shares: Rows, elapsed: np.ndarray) -> Rows:
        """How far each cell goes over to a new chunk; brings ``shares`` up to date in place.

        Args:
            shares: of the newest prediction so far; `EMPTY` where there was none.
            elapsed: steps since the last chunk (r, 1).
        """

    def reset(self, envs: Environments = None) -> None:
        """Forget everything about these environments; all: equal to a fresh timeline."""
        if envs is None:
            self._plan = np.empty((0, 0, 0), dtype=np.float32)  # (B, 3 * span, A) from the first chunk on
            self._dtype = self._plan.dtype  # of the chunks
            self._shares = np.full((1, 3 * self._span), EMPTY)
            self._added_at = np.zeros((1, 1), dtype=np.int64)  # steps
            self._step = 0
            self._head = self._span + 1  # the current step's cell
            self._covered_until = 0  # up to this step it is known that all environments have a plan
            self._rhythm, self._repeats = NO_RHYTHM, 0  # and for how many chunks in a row
        elif self._plan.size:
            self._forget_plan(envs)

    def clear(self, envs: Environments = None) -> None:
        """Forget the plan of these environments from the current step on; the last action stays."""
        if envs is not None:
            if self._plan.size:
                self._forget_plan(envs)
            return
        self._rhythm, self._repeats = NO_RHYTHM, 0
        self._shares.fill(EMPTY)
        self._covered_until = 0
        self._plan[:, self._head :] = 0

    def _forget_plan(self, envs: np.ndarray) -> None:
        self._separate()
        self._shares[envs] = EMPTY
        self._covered_until = 0
        self._plan[envs, self._head :] = 0

    def _separate(self) -> None:
        """From now on the environments may differ in what their cells have seen."""
        self._rhythm, self._repeats = NO_RHYTHM, 0
        if len(self._shares) < len(self._plan):
            self._shares = np.repeat(self._shares, len(self._plan), axis=0)
            self._added_at = np.repeat(self._added_at, len(self._plan), axis=0)

    @property
    def _window(self) -> slice:
        return slice(self._head, self._head + self.n_action_steps)

    @property
    def _last_action(self) -> np.ndarray:
        return self._plan[:, self._head - 1]

    def plan(self, envs: Environments = None) -> tuple[np.ndarray, np.ndarray]:
        """The plan (n, T, A) from the current step on, and which of its steps are covered (r, T).

        Both are empty before any chunk. Covered has one row for all environments, or one for each.
        """
        plan = self._plan[:, self._window]
        covered = (self._shares[:, self._window] < EMPTY)[:, : plan.shape[1]]
        if envs is None:
            return plan, covered
        return plan[envs], covered[envs] if len(covered) > 1 else covered

    @contextmanager
    def rewound(self, age: int) -> Iterator[None]:
        """Work as ``age`` steps ago, when the observation of a chunk was made that comes only now.

        Args:
            age: control steps, T at most. Add the chunk with at least this ``delay``: they are over.
        """
        last = self._last_action.copy()
        self._step -= age
        self._head -= age
        try:
            yield
        finally:
            self._step += age
            self._head += age
            self._last_action[:] = last

    def add(self, chunk: np.ndarray, envs: Environments = None, delay: int = 0) -> None:
        """Take in a chunk whose first action is for the current step.

        Args:
            chunk: (n, T, A), of each environment in ``envs``. The first ever must be for all.
            envs: indices of the environments that it is for.
            delay: the actions before it come too late: they are used only where there is no other. Chunks
                come in order: current step + delay never decreases.
        """
        if not self._plan.size:
            self._allocate(chunk)
        chunk, window = chunk.astype(self._plan.dtype, copy=False), self._window
        if envs is None:
            gains = self._gains_for_all(delay)
            self._covered_until = self._step + self.n_action_steps
        else:
            self._separate()
            shares = self._shares[envs, window]
            gains = self._per_dimension(
                self._take_in(shares, self._step - self._added_at[envs], delay), delay
            )
            self._added_at[envs] = self._step
            self._shares[envs, window] = shares
        rows = slice(None) if envs is None else envs
        self._plan[rows, window] = _between(self._plan[rows, window], chunk, gains)

    def _gains_for_all(self, delay: int) -> np.ndarray:
        """How far the plan goes over to a new chunk; the shares are brought up to date.

        In a steady rhythm both repeat from the moment on when no cell has seen another rhythm.
        """
        shares, elapsed = self._shares[:, self._window], self._step - self._added_at
        self._added_at.fill(self._step)
        rhythm = (int(elapsed[0, 0]), delay)
        self._repeats = self._repeats + 1 if rhythm == self._rhythm and len(shares) == 1 else 0
        self._rhythm = rhythm
        if self._repeats * rhythm[0] <= self.n_action_steps:
            self._steady_gains = self._per_dimension(self._take_in(shares, elapsed, delay), delay)
            self._steady_shares = shares.copy()
        else:
            shares[:] = self._steady_shares
        return self._steady_gains

    def _take_in(self, shares: Rows, elapsed: np.ndarray, delay: int) -> Rows:
        """Bring the shares up to date with a new chunk; returns how far each cell goes over to it."""
        gains = self._mix(shares[:, delay:], elapsed)
        if not delay:
            return gains
        empty = shares[:, :delay] == EMPTY
        shares[:, :delay][empty] = 1
        return np.concatenate([empty, gains], axis=1)

    def _per_dimension(self, gains: Rows, delay: int) -> np.ndarray:
        """The gains (r, T, A) spelled out for each action dimension."""
        spread = gains.astype(self._plan.dtype)[..., None].repeat(self._plan.shape[2], axis=2)
        if self._held_dims:
            spread[:, delay:, self._held_dims] = 1
        return spread

    def _allocate(self, chunk: np.ndarray) -> None:
        B, _, A = chunk.shape
        self._dtype = chunk.dtype
        self._plan = np.zeros((B, 3 * self._span, A), dtype=np.promote_types(chunk.dtype, np.float32))

    def pop(self) -> np.ndarray:
        """The action (B, A) of the current step; moves on to the next. Without one, the last action is held.

        Raises:
            IndexError: there was no chunk yet.
        """
        if self._step >= self._covered_until:
            self._look_ahead()
        action = self._plan[:, self._head].copy()
        self._step += 1
        self._head += 1
        if self._head > 2 * self._span:
            self._move_back()
        return action.astype(self._dtype, copy=False)

    def _look_ahead(self) -> None:
        """Find out how far all environments have a plan; those without one now go on with the last action."""
        if not self._plan.size:
            raise IndexError("no prediction covers this step: add a chunk first")
        covered = self._shares[:, self._window] < EMPTY
        self._covered_until = self._step + int(np.logical_and.accumulate(covered.all(0)).sum())
        if self._covered_until == self._step:
            self._plan[:, self._head] = np.where(covered[:, :1], self._plan[:, self._head], self._last_action)

    def _move_back(self) -> None:
        """Continue one window earlier in the cells, so that there is room for a whole window again."""
        span = self._span
        self._plan[:, : 2 * span] = self._plan[:, span:].copy()
        self._plan[:, 2 * span :] = 0
        self._shares[:, : 2 * span] = self._shares[:, span:].copy()
        self._shares[:, 2 * span :] = EMPTY
        self._head -= span


def _between(start: np.ndarray, end: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """From ``start`` towards ``end``, and exactly at either where the gain is 0 or 1."""
    difference = end - start
    return np.where(gains < 0.5, start + gains * difference, end - (1 - gains) * difference)


class NewestChunk(Timeline):
    """Follows the most recent chunk and nothing else."""

    def _mix(self, shares: Rows, elapsed: np.ndarray) -> Rows:
        shares.fill(1)
        return shares


class CrossFade(Timeline):
    """Goes over from the old plan to a new chunk in ``crossfade_steps`` equal steps."""

    def __init__(self, n_action_steps: int, crossfade_steps: int, gripper_dims: Sequence[int] = ()):
        super().__init__(n_action_steps, gripper_dims)
        self._rising = np.minimum(np.arange(1, n_action_steps + 1) / (crossfade_steps + 1), 1)

    def _mix(self, shares: Rows, elapsed: np.ndarray) -> Rows:
        gains = np.where(shares == EMPTY, 1, self._rising[: shares.shape[1]])
        shares.fill(1)
        return gains


class TemporalEnsemble(Timeline):
    """The weighted mean of all predictions for a step (ACT, Zhao et al. 2023, alg. 2), as a running average.

    Let the predictions that a cell has seen weigh W in all, the newest one being the unit, so that its share
    is 1 / W. By the next chunk that unit has changed by ``ratio``, exp(m) per step of age for ``act``, and W
    becomes W * ratio + 1: the new share is share / (share + ratio). This one rule serves every weighting and
    replanning rhythm, and every m: a share that underflows only says that new predictions do not count.

    Args:
        n_action_steps: T, the used part of each chunk [control steps].
        growth: by how much a prediction's log weight grows per step of age: m for ``act``, -m for
            ``recency``, 0 for ``uniform``.
        gripper_dims: action dimensions that follow the newest chunk alone.
    """

    def __init__(self, n_action_steps: int, growth: float, gripper_dims: Sequence[int] = ()):
        super().__init__(n_action_steps, gripper_dims)
        exponents = growth * np.arange(n_action_steps + 1)
        self._ratios = np.exp(np.minimum(exponents, MAX_EXPONENT))  # by steps elapsed

    def _mix(self, shares: Rows, elapsed: np.ndarray) -> Rows:
        ratio = self._ratios.take(elapsed, mode="clip")  # after T steps all cells are empty
        return np.divide(shares, shares + ratio, out=shares)
