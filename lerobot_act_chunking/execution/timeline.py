"""Plans over the coming steps: what to do where several chunks cover the same step."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor

Environments = Int64[Tensor, " n"] | None  # None: all of them
Rows = Float64[np.ndarray, "r T"]  # one row for all environments, or one for each

EMPTY = 1e300  # share of the newest prediction in a cell without any
NO_RHYTHM = (0, -1)  # steps elapsed since the last chunk, delay
MAX_EXPONENT = math.log(1e100)  # far above any share that still counts, far below EMPTY


class Timeline(ABC):
    """One cell per coming step, each holding a blend of the predictions for it; environments in lockstep.

    Cells for three windows are kept, a window being the last action and the T steps from now on, and the
    window moves over the last two of them, so that every operation is on one contiguous slice and the last T
    steps are still there for a chunk that comes late; memory is O(T) per environment whatever the number of
    overlapping chunks. What a cell has seen is told by the share that its newest
    prediction has in it. Shares live in NumPy, whose calls cost a third of PyTorch's, with one row for all
    environments until one is treated alone.

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
    def _mix(self, shares: Rows, elapsed: Int64[np.ndarray, "r 1"]) -> Rows:
        """How far each cell goes over to a new chunk; brings ``shares`` up to date in place.

        Args:
            shares: of the newest prediction so far; `EMPTY` where there was none.
            elapsed: steps since the last chunk.
        """

    def reset(self, envs: Environments = None) -> None:
        """Forget everything about these environments; all: equal to a fresh timeline."""
        if envs is None:
            self._plan = torch.empty(0, 0, 0)  # (B, 3 * span, A) from the first chunk on
            self._dtype = torch.float32  # of the chunks
            self._shares = np.full((1, 3 * self._span), EMPTY)
            self._added_at = np.zeros((1, 1), dtype=np.int64)  # steps
            self._step = 0
            self._head = self._span + 1  # the current step's cell
            self._covered_until = 0  # up to this step it is known that all environments have a plan
            self._rhythm, self._repeats = NO_RHYTHM, 0  # and for how many chunks in a row
        elif self._plan.numel():
            self._forget_plan(envs)

    def clear(self, envs: Environments = None) -> None:
        """Forget the plan of these environments from the current step on; the last action stays."""
        if envs is not None:
            if self._plan.numel():
                self._forget_plan(envs)
            return
        self._rhythm, self._repeats = NO_RHYTHM, 0
        self._shares.fill(EMPTY)
        self._covered_until = 0
        self._plan[:, self._head :] = 0

    def _forget_plan(self, envs: Int64[Tensor, " n"]) -> None:
        self._separate()
        self._shares[envs.numpy()] = EMPTY
        self._covered_until = 0
        self._plan[envs.to(self._plan.device), self._head :] = 0

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
    def _last_action(self) -> Float[Tensor, "B A"]:
        return self._plan[:, self._head - 1]

    def plan(self, envs: Environments = None) -> tuple[Float[Tensor, "n T A"], Bool[Tensor, "r T"]]:
        """The plan from the current step on, and which of its steps are covered; empty before any chunk.

        Covered has one row for all environments, or one for each.
        """
        plan = self._plan[:, self._window]
        covered = torch.from_numpy(self._shares[:, self._window] < EMPTY)[:, : plan.shape[1]]
        if envs is None:
            return plan, covered
        return plan[envs.to(plan.device)], covered[envs] if len(covered) > 1 else covered

    @contextmanager
    def rewound(self, age: int) -> Iterator[None]:
        """Work as ``age`` steps ago, when the observation of a chunk was made that comes only now.

        Args:
            age: control steps, T at most. Add the chunk with at least this ``delay``: they are over.
        """
        last = self._last_action.clone()
        self._step -= age
        self._head -= age
        try:
            yield
        finally:
            self._step += age
            self._head += age
            self._last_action[:] = last

    def add(self, chunk: Float[Tensor, "n T A"], envs: Environments = None, delay: int = 0) -> None:
        """Take in a chunk whose first action is for the current step.

        Args:
            chunk: the chunk of each environment in ``envs``. The first ever must be for all.
            envs: indices of the environments that it is for.
            delay: the actions before it come too late: they are used only where there is no other. Chunks
                come in order: current step + delay never decreases.
        """
        if not self._plan.numel():
            self._allocate(chunk)
        chunk, window = chunk.to(self._plan.dtype), self._window
        if envs is None:
            self._plan[:, window].lerp_(chunk, self._gains_for_all(delay))
            self._covered_until = self._step + self.n_action_steps
        else:
            self._separate()
            rows, envs = envs.numpy(), envs.to(self._plan.device)
            shares = self._shares[rows, window]
            gains = self._take_in(shares, self._step - self._added_at[rows], delay)
            self._added_at[rows] = self._step
            self._shares[rows, window] = shares
            self._plan[envs, window] = self._plan[envs, window].lerp_(
                chunk, self._per_dimension(gains, delay)
            )

    def _gains_for_all(self, delay: int) -> Float[Tensor, "r T A"]:
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

    def _take_in(self, shares: Rows, elapsed: Int64[np.ndarray, "r 1"], delay: int) -> Rows:
        """Bring the shares up to date with a new chunk; returns how far each cell goes over to it."""
        gains = self._mix(shares[:, delay:], elapsed)
        if not delay:
            return gains
        empty = shares[:, :delay] == EMPTY
        shares[:, :delay][empty] = 1
        return np.concatenate([empty, gains], axis=1)

    def _per_dimension(self, gains: Rows, delay: int) -> Float[Tensor, "r T A"]:
        """The gains spelled out for each action dimension: broadcasting would make `lerp_` 4 times slower."""
        if self._plan.dtype == torch.float32:
            gains = gains.astype(np.float32)
        spread = gains.repeat(self._plan.shape[2], axis=1).reshape(*gains.shape, -1)
        if self._held_dims:
            spread[:, delay:, self._held_dims] = 1
        return torch.from_numpy(spread).to(self._plan.device)

    def _allocate(self, chunk: Tensor) -> None:
        B, _, A = chunk.shape
        self._dtype = chunk.dtype
        dtype = torch.promote_types(chunk.dtype, torch.float32)
        self._plan = torch.zeros(B, 3 * self._span, A, dtype=dtype, device=chunk.device)

    def pop(self) -> Float[Tensor, "B A"]:
        """The action of the current step; moves on to the next. Without one, the last action is held.

        Raises:
            IndexError: there was no chunk yet.
        """
        if self._step >= self._covered_until:
            self._look_ahead()
        action = self._plan[:, self._head].clone()
        self._step += 1
        self._head += 1
        if self._head > 2 * self._span:
            self._move_back()
        return action if action.dtype == self._dtype else action.to(self._dtype)

    def _look_ahead(self) -> None:
        """Find out how far all environments have a plan; those without one now go on with the last action."""
        if not self._plan.numel():
            raise IndexError("no prediction covers this step: add a chunk first")
        covered = self._shares[:, self._window] < EMPTY
        self._covered_until = self._step + int(np.logical_and.accumulate(covered.all(0)).sum())
        if self._covered_until == self._step:
            here = torch.from_numpy(covered[:, :1]).to(self._plan.device)
            action = torch.where(here, self._plan[:, self._head], self._last_action)
            self._plan[:, self._head] = action

    def _move_back(self) -> None:
        """Continue one window earlier in the cells, so that there is room for a whole window again."""
        span = self._span
        self._plan[:, : 2 * span] = self._plan[:, span:].clone()
        self._plan[:, 2 * span :] = 0
        self._shares[:, : 2 * span] = self._shares[:, span:].copy()
        self._shares[:, 2 * span :] = EMPTY
        self._head -= span


class NewestChunk(Timeline):
    """Follows the most recent chunk and nothing else."""

    def _mix(self, shares: Rows, elapsed: Int64[np.ndarray, "r 1"]) -> Rows:
        shares.fill(1)
        return shares


class CrossFade(Timeline):
    """Goes over from the old plan to a new chunk in ``crossfade_steps`` equal steps."""

    def __init__(self, n_action_steps: int, crossfade_steps: int, gripper_dims: Sequence[int] = ()):
        super().__init__(n_action_steps, gripper_dims)
        self._rising = np.minimum(np.arange(1, n_action_steps + 1) / (crossfade_steps + 1), 1)

    def _mix(self, shares: Rows, elapsed: Int64[np.ndarray, "r 1"]) -> Rows:
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

    def _mix(self, shares: Rows, elapsed: Int64[np.ndarray, "r 1"]) -> Rows:
        ratio = self._ratios.take(elapsed, mode="clip")  # after T steps all cells are empty
        return np.divide(shares, shares + ratio, out=shares)
