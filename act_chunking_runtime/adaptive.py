"""Averaging only predictions that belong to the same plan."""

from collections.abc import Sequence

import numpy as np

from act_chunking_runtime.settings import Kernel
from act_chunking_runtime.timeline import Environments, NewestChunk

# Typical disagreement: the median over this many arrivals, known once there were a few.
MEMORY = 64
FEWEST = 4
LEAST = 1e-8  # length of a vector that has a direction


class AdaptiveEnsemble(NewestChunk):
    """The weighted mean of the chunks that agree with the newest one.

    A prediction's weight is that of its age, as in `TemporalEnsemble`, times its agreement with the newest:

    ========  ================================================================================================
    cosine    exp(scale * cos), for each step, between what both would change from the last executed action
              (CogACT, Li et al. 2024, on changes: absolute joint targets all point the same way)
    gaussian  exp(-rms² / (2 sigma²)), for each step, rms being the distance over the dimensions and sigma
              ``scale`` times the typical disagreement
    gate      1 for a chunk within ``scale`` times the typical disagreement over all steps that both cover,
              else 0; if no older chunk is, all are forgotten: after a disturbance only what saw it counts
    ========  ================================================================================================

    What is typical is learned from the rollout, for each environment: the running median of the median
    distance between a new chunk and the older ones. The first `FEWEST` of them are all accepted.

    The blend is worked out when a chunk arrives, from the older chunks that still cover something.

    Args:
        n_action_steps: T, the used part of each chunk [control steps].
        growth: by how much a prediction's log weight grows per step of age.
        kernel: how agreement is measured.
        scale: its sharpness (cosine) or tolerance.
        n_chunks: the most that are averaged.
        gripper_dims: action dimensions that follow the newest chunk alone, and have no say in agreement.
    """

    def __init__(
        self,
        n_action_steps: int,
        growth: float,
        kernel: Kernel,
        scale: float,
        n_chunks: int,
        gripper_dims: Sequence[int] = (),
    ):
        self._growth, self._kernel, self._scale = growth, kernel, scale
        self._n_older = max(1, n_chunks - 1)
        super().__init__(n_action_steps, gripper_dims)

    def reset(self, envs: Environments = None) -> None:
        """Forget everything about these environments, what is typical of them too."""
        super().reset(envs)
        if envs is not None and self._plan.size:
            self._older[envs] = 0
            self._counts[envs] = False
            self._disagreements[envs] = np.nan

    def clear(self, envs: Environments = None) -> None:
        """Forget plans and older chunks; what is typical of an environment stays."""
        super().clear(envs)
        if self._plan.size:
            rows = slice(None) if envs is None else envs
            self._older[rows] = 0
            self._counts[rows] = False

    def _allocate(self, chunk: np.ndarray) -> None:
        super()._allocate(chunk)
        B, cells, A = self._plan.shape
        self._older = np.zeros((B, self._n_older, cells, A), dtype=self._plan.dtype)
        self._counts = np.zeros((B, self._n_older, cells), dtype=bool)
        self._made_at = np.full((B, self._n_older), -1)
        self._disagreements = np.full((B, MEMORY), np.nan, dtype=self._plan.dtype)  # oldest first

    def _move_back(self) -> None:
        super()._move_back()
        for cells in (self._older, self._counts):
            cells[:, :, : 2 * self._span] = cells[:, :, self._span :].copy()
            cells[:, :, 2 * self._span :] = 0

    def add(self, chunk: np.ndarray, envs: Environments = None, delay: int = 0) -> None:
        """Take in a chunk, blended with those that it agrees with; see `Timeline.add`."""
        if not self._plan.size:
            self._allocate(chunk)
        rows = np.arange(len(chunk)) if envs is None else envs
        chunk = chunk.astype(self._plan.dtype, copy=False)
        blend = chunk.copy()
        blend[:, delay:] = self._agreed(chunk[:, delay:], rows, delay)
        super().add(blend, envs, delay)
        self._remember(chunk, rows)

    def _remember(self, chunk: np.ndarray, rows: np.ndarray) -> None:
        """Keep the chunk (n, T, A) in place of the oldest."""
        oldest = self._made_at[rows].argmin(1)
        self._older[rows, oldest, self._window] = chunk
        self._counts[rows, oldest] = False
        self._counts[rows, oldest, self._window] = True
        self._made_at[rows, oldest] = self._step

    def _agreed(self, newest: np.ndarray, rows: np.ndarray, delay: int) -> np.ndarray:
        """The average of the newest chunk (n, t, A) and the older ones, over the steps it is in time for."""
        cells = slice(self._head + delay, self._head + self.n_action_steps)
        votes = np.concatenate([newest[:, None], self._older[rows, :, cells]], axis=1)  # (n, C, t, A)
        counts = np.pad(self._counts[rows, :, cells], ((0, 0), (1, 0), (0, 0)), constant_values=True)
        ages = np.pad(self._step - self._made_at[rows], ((0, 0), (1, 0))).astype(votes.dtype)
        weights = self._log_agreement(votes, counts, rows) + self._growth * ages[:, :, None]
        weights = _softmax(np.where(counts, weights, -np.inf))
        mean = newest + (weights[..., None] * (votes - newest[:, None])).sum(1)
        mean[..., self._held_dims] = newest[..., self._held_dims]
        return mean

    def _log_agreement(self, votes: np.ndarray, counts: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Log of the agreement of each vote (n, C, t, A) with the first, (n, C, t) or (n, C, 1)."""
        free = [dim for dim in range(votes.shape[-1]) if dim not in self._held_dims]
        votes = votes[..., free]
        if self._kernel == "cosine":
            change = votes - self._last_action[rows][:, None, None, free]
            # The last action may be that of a rollout that ended in NaN.
            return np.nan_to_num(self._scale * _cosine(change, change[:, :1]))
        squared = np.square(votes - votes[:, :1]).sum(-1) / max(1, len(free))
        squared = np.where(counts, squared, 0)
        n_counted = counts.sum(-1)  # (n, C)
        distance = np.sqrt(squared.sum(-1) / n_counted.clip(min=1)).astype(votes.dtype)
        exists = n_counted > 0
        tolerance = self._scale * self._typical(rows)[:, None]
        self._note(distance, exists, rows)
        if self._kernel == "gaussian":
            variance = np.square(tolerance).clip(min=np.finfo(votes.dtype).tiny)
            return -squared / (2 * variance[..., None])
        rejected = exists & (distance > tolerance)
        disturbed = (rejected | ~exists)[:, 1:].all(1)
        self._counts[rows] &= ~disturbed[:, None, None]
        return np.where(rejected, -np.inf, 0.0).astype(votes.dtype)[..., None]

    def _typical(self, rows: np.ndarray) -> np.ndarray:
        """The running median of disagreement (n,); infinite until enough is known."""
        known = self._disagreements[rows]
        enough = (~np.isnan(known)).sum(1) >= FEWEST
        return np.where(enough, _lower_median(known), np.inf).astype(known.dtype)

    def _note(self, distance: np.ndarray, exists: np.ndarray, rows: np.ndarray) -> None:
        """Remember how far (n, C) the older chunks are from the newest, if there are any (n, C)."""
        latest = _lower_median(np.where(exists, distance, np.nan)[:, 1:])[:, None]
        before = self._disagreements[rows]
        shifted = np.concatenate([before[:, 1:], latest], axis=1)
        self._disagreements[rows] = np.where(np.isnan(latest), before, shifted)


def _softmax(logits: np.ndarray) -> np.ndarray:
    """Over the votes, axis 1."""
    weights = np.exp(logits - logits.max(1, keepdims=True))
    return weights / weights.sum(1, keepdims=True)


def _cosine(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Of the angle between vectors on the last axis; 0 where one of them is nothing."""
    lengths = np.linalg.norm(x, axis=-1).clip(min=LEAST) * np.linalg.norm(y, axis=-1).clip(min=LEAST)
    return (x * y).sum(-1) / lengths


def _lower_median(values: np.ndarray) -> np.ndarray:
    """Of what is not NaN in each row, the lower one of two; NaN where there is nothing."""
    middle = ((~np.isnan(values)).sum(1, keepdims=True) - 1).clip(min=0) // 2
    return np.take_along_axis(np.sort(values, axis=1), middle, axis=1)[:, 0]
