"""Averaging only predictions that belong to the same plan."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import cosine_similarity, pad

from lerobot_act_chunking.execution.settings import Kernel
from lerobot_act_chunking.execution.timeline import Environments, NewestChunk

# Typical disagreement: the median over this many arrivals, known once there were a few.
MEMORY = 64
FEWEST = 4


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
        if envs is not None and self._plan.numel():
            envs = envs.to(self._plan.device)
            self._older[envs] = 0
            self._counts[envs] = False
            self._disagreements[envs] = torch.nan

    def clear(self, envs: Environments = None) -> None:
        """Forget plans and older chunks; what is typical of an environment stays."""
        super().clear(envs)
        if self._plan.numel():
            rows = slice(None) if envs is None else envs.to(self._plan.device)
            self._older[rows] = 0
            self._counts[rows] = False

    def _allocate(self, chunk: Tensor) -> None:
        super()._allocate(chunk)
        B, cells, A = self._plan.shape
        self._older = self._plan.new_zeros(B, self._n_older, cells, A)
        self._counts = torch.zeros(B, self._n_older, cells, dtype=torch.bool, device=chunk.device)
        self._made_at = torch.full((B, self._n_older), -1, device=chunk.device)
        self._disagreements = self._plan.new_full((B, MEMORY), torch.nan)  # oldest first

    def _move_back(self) -> None:
        super()._move_back()
        for cells in (self._older, self._counts):
            cells[:, :, : 2 * self._span] = cells[:, :, self._span :].clone()
            cells[:, :, 2 * self._span :] = 0

    def add(self, chunk: Float[Tensor, "n T A"], envs: Environments = None, delay: int = 0) -> None:
        """Take in a chunk, blended with those that it agrees with; see `Timeline.add`."""
        if not self._plan.numel():
            self._allocate(chunk)
        device = self._plan.device
        rows = torch.arange(len(chunk), device=device) if envs is None else envs.to(device)
        chunk = chunk.to(self._plan.dtype)
        blend = chunk.clone()
        blend[:, delay:] = self._agreed(chunk[:, delay:], rows, delay)
        super().add(blend, envs, delay)
        self._remember(chunk, rows)

    def _remember(self, chunk: Float[Tensor, "n T A"], rows: Tensor) -> None:
        """Keep the chunk in place of the oldest."""
        oldest = self._made_at[rows].argmin(1)
        self._older[rows, oldest, self._window] = chunk
        self._counts[rows, oldest] = False
        self._counts[rows, oldest, self._window] = True
        self._made_at[rows, oldest] = self._step

    def _agreed(self, newest: Float[Tensor, "n t A"], rows: Tensor, delay: int) -> Float[Tensor, "n t A"]:
        """The average of the newest chunk and the older ones, over the steps that it is in time for."""
        cells = slice(self._head + delay, self._head + self.n_action_steps)
        votes = torch.cat([newest[:, None], self._older[rows, :, cells]], dim=1)  # (n, C, t, A)
        counts = self._counts[rows, :, cells]
        counts = pad(counts, (0, 0, 1, 0), value=True)
        ages = pad(self._step - self._made_at[rows], (1, 0)).to(votes)
        weights = self._log_agreement(votes, counts, rows) + self._growth * ages[:, :, None]
        weights = weights.masked_fill(~counts, -torch.inf).softmax(1)
        mean = newest + (weights[..., None] * (votes - newest[:, None])).sum(1)
        mean[..., self._held_dims] = newest[..., self._held_dims]
        return mean

    def _log_agreement(
        self, votes: Float[Tensor, "n C t A"], counts: Bool[Tensor, "n C t"], rows: Tensor
    ) -> Float[Tensor, "n C #t"]:
        """Log of the agreement of each vote with the first."""
        free = [dim for dim in range(votes.shape[-1]) if dim not in self._held_dims]
        votes = votes[..., free]
        if self._kernel == "cosine":
            change = votes - self._last_action[rows][:, None, None, free]
            # The last action may be that of a rollout that ended in NaN.
            return self._scale * cosine_similarity(change, change[:, :1], dim=-1).nan_to_num()
        squared = (votes - votes[:, :1]).square().sum(-1) / max(1, len(free))
        squared = squared.masked_fill(~counts, 0)
        distance = (squared.sum(-1) / counts.sum(-1).clamp(min=1)).sqrt()  # (n, C)
        exists = counts.any(-1)
        tolerance = self._scale * self._typical(rows)[:, None]
        self._note(distance, exists, rows)
        if self._kernel == "gaussian":
            variance = tolerance.square().clamp(min=torch.finfo(votes.dtype).tiny)
            return -squared / (2 * variance[..., None])
        rejected = exists & (distance > tolerance)
        disturbed = (rejected | ~exists)[:, 1:].all(1)
        self._counts[rows] &= ~disturbed[:, None, None]
        return torch.where(rejected, -torch.inf, 0.0).to(votes)[..., None]

    def _typical(self, rows: Tensor) -> Float[Tensor, " n"]:
        """The running median of disagreement; infinite until enough is known."""
        known = self._disagreements[rows]
        enough = (~known.isnan()).sum(1) >= FEWEST
        return torch.where(enough, known.nanmedian(1).values, torch.inf)

    def _note(self, distance: Float[Tensor, "n C"], exists: Bool[Tensor, "n C"], rows: Tensor) -> None:
        """Remember how far the older chunks are from the newest, if there are any."""
        latest = distance[:, 1:].masked_fill(~exists[:, 1:], torch.nan).nanmedian(1, keepdim=True).values
        before = self._disagreements[rows]
        shifted = torch.cat([before[:, 1:], latest], dim=1)
        self._disagreements[rows] = torch.where(latest.isnan(), before, shifted)
