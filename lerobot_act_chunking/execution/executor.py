"""When to ask for a new chunk, and for which environments."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.execution.adaptive import AdaptiveEnsemble
from lerobot_act_chunking.execution.coherence import most_coherent
from lerobot_act_chunking.execution.settings import ExecutionSettings
from lerobot_act_chunking.execution.timeline import (
    CrossFade,
    Environments,
    NewestChunk,
    TemporalEnsemble,
    Timeline,
)

# Gives the chunks (n, T, A) that start now for the environments asked for (None: all); (N, n, T, A) if the
# mode chooses among N samples.
Predict = Callable[[Environments], Float[Tensor, "*N n T A"]]


@dataclass(frozen=True)
class ChunkEvent:
    """A chunk was taken in.

    Attributes:
        step: control steps since the executor's last full reset.
        envs: the environments it is for; None for all.
        chunk: (n, T, A) as the policy predicted it.
    """

    step: int
    envs: Environments
    chunk: Tensor


class ChunkExecutor:
    """Asks for a chunk every ``replan_interval`` control steps and executes as ``settings`` say in between.

    All environments of a batch advance together, but each may be reset alone, and only those that need a new
    chunk are asked for one. A different batch size can only mean another rollout, so it starts afresh.

    Attributes:
        settings: how chunks are executed.
        on_chunk: called with every chunk taken in, for instruments.
    """

    def __init__(self, settings: ExecutionSettings):
        self.settings = settings
        self.on_chunk: Callable[[ChunkEvent], None] | None = None
        self._timeline = make_timeline(settings)
        self.reset()

    def __len__(self) -> int:
        """Control steps left before the next chunk is asked for."""
        return int(self._left.min()) if len(self._left) else 0

    def reset(self, envs: Tensor | Sequence[int] | None = None) -> None:
        """Start a new rollout, in all environments (equal to a fresh executor) or in these alone."""
        if envs is None:
            self._left = np.zeros(0, dtype=np.int64)  # (B,) steps until each next chunk
            self._step = 0
            self._timeline.reset()
        elif len(self._left):
            envs = torch.as_tensor(envs, dtype=torch.int64)
            self._left[envs.numpy()] = 0
            self._timeline.reset(envs)

    def step(self, predict: Predict, batch_size: int) -> Float[Tensor, "B A"]:
        """The action of this control step.

        Args:
            predict: called only if a chunk is due, with the environments that need one.
            batch_size: number of environments now.

        Raises:
            ValueError: a chunk is shorter than ``n_action_steps``, or not for the environments asked for.
        """
        if batch_size != len(self._left):
            self.reset()
            self._left = np.zeros(batch_size, dtype=np.int64)
        due = np.flatnonzero(self._left == 0)
        if len(due):
            envs = None if len(due) == batch_size else torch.from_numpy(due)
            self.add(predict(envs), envs, self.settings.latency_steps)
        return self.pop()

    def add(self, chunk: Float[Tensor, "*N n T A"], envs: Environments = None, delay: int = 0) -> None:
        """Take in a chunk whose first action is for the current step; for callers who keep time themselves.

        Args:
            chunk: as from ``predict``.
            envs: the environments it is for; None for all.
            delay: steps that its computation took: the older plan goes on for as long.
        """
        self._check(chunk, envs)
        if chunk.ndim == 4:
            chunk = most_coherent(chunk, *self._timeline.plan(envs))
        if not len(self._left):
            self._left = np.zeros(len(chunk), dtype=np.int64)
        self._timeline.add(chunk, envs, delay)
        self._left[slice(None) if envs is None else envs.numpy()] = self.settings.replan_interval
        if self.on_chunk is not None:
            self.on_chunk(ChunkEvent(self._step, envs, chunk))

    def pop(self) -> Float[Tensor, "B A"]:
        """The action of the current step; the last one is held if no chunk covers it."""
        action = self._timeline.pop()
        self._step += 1
        np.maximum(self._left - 1, 0, out=self._left)
        return action

    def _check(self, chunk: Tensor, envs: Environments) -> None:
        needed = self.settings.n_action_steps
        if chunk.shape[-2] < needed:
            raise ValueError(f"a chunk of {chunk.shape[-2]} actions is too short for n_action_steps={needed}")
        expected = len(self._left if envs is None else envs) or chunk.shape[-3]
        if chunk.shape[-3] != expected:
            raise ValueError(f"{chunk.shape[-3]} chunks for {expected} environments")
        outside = [dim for dim in self.settings.gripper_dims if dim >= chunk.shape[-1]]
        if outside:
            raise ValueError(f"gripper_dims={outside} are beyond the {chunk.shape[-1]} action dimensions")


def make_timeline(settings: ExecutionSettings) -> Timeline:
    """The timeline that executes chunks as ``settings`` say."""
    T, held = settings.n_action_steps, settings.gripper_dims
    if settings.execution == "ensemble":
        return TemporalEnsemble(T, settings.weight_growth, held)
    if settings.execution == "adaptive":
        return AdaptiveEnsemble(
            T,
            settings.weight_growth,
            settings.adaptive_kernel or "gate",
            settings.adaptive_scale or 1.0,
            settings.overlapping_chunks,
            held,
        )
    if settings.execution == "crossfade":
        return CrossFade(T, settings.crossfade_steps or 1, held)
    return NewestChunk(T, held)
