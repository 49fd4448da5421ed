"""Plans over the coming steps: what to do where several chunks cover the same step."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor

Environments = Int64[Tensor, " n"] | None  # None: all of them
Rows = Float64[np.ndarray, "r T"]  # one row for all environments, or one for each

# Beyond these, all that matters is that the newest prediction has no share; finite, so that 0 * ratio = 0.
MAX_WEIGHT = 1e200
MAX_EXPONENT = math.log(1e100)


class Timeline(ABC):
    """One cell per coming step, each holding a blend of the predictions for it; environments in lockstep.

    Two windows' worth of cells are kept and the window moves over them, so that every operation is on one
    contiguous slice; memory is O(T) per environment whatever the number of overlapping chunks. ``_weights``
    say what a cell has seen (0: nothing). They live in NumPy, whose calls cost a fifth of PyTorch's, and have
    one row for all environments until one is reset alone.

    Args:
        n_action_steps: T, the used part of each chunk [control steps].
        gripper_dims: action dimensions that follow the newest chunk alone.
    """

    def __init__(self, n_action_steps: int, gripper_dims: Sequence[int] = ()):
        self.n_action_steps = n_action_steps
        self._held_dims = list(gripper_dims)
        self.reset()

    @abstractmethod
    def _gains(self, weights: Rows, elapsed: Float64[np.ndarray, "r 1"]) -> Rows:
        """Share of a new chunk in each cell; brings ``weights`` up to date in place.

        Args:
            weights: what the cells hold so far.
            elapsed: steps since the last chunk.
        """

    def reset(self, envs: Environments = None) -> None:
        """Forget everything about these environments; all: equal to a fresh timeline."""
        if envs is None:
            self._plan = torch.empty(0, 0, 0)  # (B, 2T, A) from the first chunk on
            self._held = torch.empty(0, 0)  # (B, A), the last action
            self._dtype = torch.float32  # of the chunks
            self._weights = np.zeros((1, 2 * self.n_action_steps))
            self._added_at = np.zeros((1, 1))  # steps
            self._step = self._head = 0
        elif len(self._plan):
            self._separate()
            self._weights[envs.numpy()] = 0

    def _separate(self) -> None:
        """From now on the environments may differ in what their cells have seen."""
        if len(self._weights) < len(self._plan):
            self._weights = np.repeat(self._weights, len(self._plan), axis=0)
            self._added_at = np.repeat(self._added_at, len(self._plan), axis=0)

    @property
    def _window(self) -> slice:
        return slice(self._head, self._head + self.n_action_steps)

    def plan(self, envs: Environments = None) -> tuple[Float[Tensor, "n T A"], Bool[Tensor, "r T"]]:
        """The plan from the current step on, and which of its steps are covered; empty before any chunk.

        Covered has one row for all environments, or one for each.
        """
        plan, covered = self._plan[:, self._window], torch.from_numpy(self._weights[:, self._window] > 0)
        if envs is None:
            return plan, covered
        return plan[envs.to(plan.device)], covered[envs] if len(covered) > 1 else covered

    def add(self, chunk: Float[Tensor, "n T A"], envs: Environments = None, delay: int = 0) -> None:
        """Take in a chunk whose first action is for the current step.

        Args:
            chunk: the chunk of each environment in ``envs``. The first ever must be for all.
            envs: indices of the environments that it is for.
            delay: the actions before it come too late: they are used only where there is no other.
        """
        if not len(self._plan):
            self._allocate(chunk)
        if envs is not None:
            self._separate()
        chunk = chunk[:, : self.n_action_steps].to(self._plan.dtype)
        gains = self._take_in(envs, delay)
        plan = self._plan[:, self._window]
        if envs is None:
            self._blend(plan, chunk, gains, delay)
        else:
            envs = envs.to(plan.device)
            part = plan[envs]
            self._blend(part, chunk, gains, delay)
            plan[envs] = part

    def _take_in(self, envs: Environments, delay: int) -> Rows:
        """Update the weights for a new chunk; returns its share in each cell."""
        rows = slice(None) if envs is None else envs.numpy()
        weights = self._weights[rows, self._window]  # a view for all, else a copy
        gains = np.empty_like(weights)
        gains[:, :delay] = weights[:, :delay] == 0
        weights[:, :delay] += gains[:, :delay]
        gains[:, delay:] = self._gains(weights[:, delay:], self._step - self._added_at[rows])
        self._added_at[rows] = self._step
        if envs is not None:
            self._weights[rows, self._window] = weights
        return gains

    def _blend(self, plan: Tensor, chunk: Tensor, gains: Rows, delay: int) -> None:
        plan.lerp_(chunk, torch.from_numpy(gains[..., None]).to(plan))
        if self._held_dims:
            plan[:, delay:, self._held_dims] = chunk[:, delay:, self._held_dims]

    def _allocate(self, chunk: Tensor) -> None:
        B, _, A = chunk.shape
        dtype = torch.promote_types(chunk.dtype, torch.float32)
        self._plan = torch.zeros(B, 2 * self.n_action_steps, A, dtype=dtype, device=chunk.device)
        self._held = self._plan[:, 0]
        self._dtype = chunk.dtype

    def pop(self) -> Float[Tensor, "B A"]:
        """The action of the current step; moves on to the next. Without one, the last action is held.

        Raises:
            IndexError: there was no chunk yet.
        """
        if not len(self._plan):
            raise IndexError("no prediction covers this step: add a chunk first")
        action = self._plan[:, self._head]
        covered = self._weights[:, self._head] > 0
        if covered.all():
            action = action.clone()
        else:
            action = torch.where(torch.from_numpy(covered)[:, None].to(action.device), action, self._held)
        self._held = action
        self._step += 1
        self._head += 1
        if self._head == self.n_action_steps:
            self._move_back()
        return action.to(self._dtype)

    def _move_back(self) -> None:
        """Continue at the start of the cells, so that there is room for a whole window again."""
        T = self.n_action_steps
        self._plan[:, :T] = self._plan[:, T:]
        self._weights[:, :T] = self._weights[:, T:]
        self._weights[:, T:] = 0
        self._head = 0


class NewestChunk(Timeline):
    """Follows the most recent chunk and nothing else."""

    def _gains(self, weights: Rows, elapsed: Float64[np.ndarray, "r 1"]) -> Rows:
        weights.fill(1)
        return weights


class CrossFade(Timeline):
    """Goes over from the old plan to a new chunk in ``crossfade_steps`` equal steps."""

    def __init__(self, n_action_steps: int, crossfade_steps: int, gripper_dims: Sequence[int] = ()):
        super().__init__(n_action_steps, gripper_dims)
        self._rising = np.minimum(np.arange(1, n_action_steps + 1) / (crossfade_steps + 1), 1)

    def _gains(self, weights: Rows, elapsed: Float64[np.ndarray, "r 1"]) -> Rows:
        gains = np.where(weights > 0, self._rising[: weights.shape[1]], 1)
        weights.fill(1)
        return gains


class TemporalEnsemble(Timeline):
    """The weighted mean of all predictions for a step (ACT, Zhao et al. 2023, alg. 2), as a running average.

    A cell's weight is the sum of its predictions' weights in units of the newest one's. That unit changes by
    exp(m) per step of age, towards larger sums for ``act`` (old predictions weigh more), smaller ones for
    ``recency``; so one rule, ``sum = sum * ratio + 1``, serves both, any replanning rhythm, and any m: a sum
    that overflows only says that the newest prediction does not count.

    Args:
        n_action_steps: T, the used part of each chunk [control steps].
        growth: by how much a prediction's log weight grows per step of age: m for ``act``, -m for
            ``recency``, 0 for ``uniform``.
        gripper_dims: action dimensions that follow the newest chunk alone.
    """

    def __init__(self, n_action_steps: int, growth: float, gripper_dims: Sequence[int] = ()):
        super().__init__(n_action_steps, gripper_dims)
        self._growth = growth

    def _gains(self, weights: Rows, elapsed: Float64[np.ndarray, "r 1"]) -> Rows:
        weights *= np.exp(np.minimum(self._growth * elapsed, MAX_EXPONENT))
        weights += 1
        np.minimum(weights, MAX_WEIGHT, out=weights)
        return 1 / weights
