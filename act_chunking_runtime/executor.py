"""When to ask for a new chunk, and for which environments."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from act_chunking_runtime.adaptive import AdaptiveEnsemble
from act_chunking_runtime.coherence import most_coherent
from act_chunking_runtime.settings import ExecutionSettings
from act_chunking_runtime.smoothing import moving_mean
from act_chunking_runtime.timeline import (
    CrossFade,
    Environments,
    NewestChunk,
    TemporalEnsemble,
    Timeline,
)

# Gives the chunks (n, T, A) that start now for the environments asked for (None: all); (N, n, T, A) if the
# mode chooses among N samples.
Predict = Callable[[Environments], np.ndarray]
# Sees to all that such a chunk depends on, for the environments asked for and the control steps that it will
# be late; what it gives computes the chunk, in any thread.
Prepare = Callable[[Environments, int], Callable[[], np.ndarray]]


@dataclass(frozen=True)
class ChunkEvent[ArrayT]:
    """A chunk was taken in.

    Attributes:
        step: control steps since the executor's last full reset.
        envs: the environments it is for; None for all.
        chunk: (n, T, A) as the policy predicted it.
    """

    step: int
    envs: ArrayT | None
    chunk: ArrayT


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
        self.on_chunk: Callable[[ChunkEvent[np.ndarray]], None] | None = None
        self._timeline = make_timeline(settings)
        self.reset()

    @property
    def n_steps(self) -> int:
        """Control steps since the last full reset."""
        return self._step

    def __len__(self) -> int:
        """Control steps left before the next chunk is asked for."""
        return max(0, self._first_due - self._step)

    def reset(self, envs: np.ndarray | Sequence[int] | None = None) -> None:
        """Start a new rollout, in all environments (equal to a fresh executor) or in these alone.

        Args:
            envs: their indices, or a mask over all.
        """
        if envs is None:
            self._start(0)
        elif len(self._due_at):
            envs = np.asarray(envs)
            envs = np.flatnonzero(envs) if envs.dtype == bool else envs.astype(np.int64)
            self._schedule(envs, self._step)
            self._timeline.reset(envs)

    def clear(self, envs: Environments = None) -> None:
        """Drop the actions that wait: the next step asks for a chunk in these environments; None for all.

        All else goes on: time, what was executed, what was learned from the rollout. LeRobot's
        ``drop_queued_actions`` calls this when the instruction changes within an episode.
        """
        if len(self._due_at) or envs is None:
            self._schedule(envs, self._step)
            self._timeline.clear(envs)

    def _start(self, batch_size: int) -> None:
        self._due_at = np.zeros(batch_size, dtype=np.int64)  # (B,) the step of each next chunk
        self._first_due = self._last_due = self._step = 0
        self._timeline.reset()

    def _schedule(self, envs: Environments, step: int) -> None:
        """Ask for the next chunk of these environments at that step."""
        if envs is None:
            self._due_at.fill(step)
            self._first_due = self._last_due = step
        else:
            self._due_at[envs] = step
            self._first_due, self._last_due = int(self._due_at.min()), int(self._due_at.max())

    def step(self, predict: Predict, batch_size: int) -> np.ndarray:
        """The action (B, A) of this control step.

        Args:
            predict: called only if a chunk is due, with the environments that need one.
            batch_size: number of environments now.

        Raises:
            ValueError: a chunk is shorter than ``n_action_steps``, or not for the environments asked for.
        """
        if batch_size != len(self._due_at):
            self._start(batch_size)
        if self._step >= self._first_due:
            envs = self._due()
            self.add(predict(envs), envs, self.settings.latency_steps)
        return self.pop()

    def advance(self, prepare: Prepare, batch_size: int) -> np.ndarray:
        """The action (B, A) of this control step, of a policy whose chunks may be computed elsewhere.

        Args:
            prepare: called only if a chunk is due.
            batch_size: number of environments now.

        Raises:
            ValueError: as `step`.
        """
        return self.step(lambda envs: prepare(envs, self.settings.latency_steps)(), batch_size)

    def _due(self) -> Environments:
        if self._step >= self._last_due:
            return None
        return np.flatnonzero(self._due_at <= self._step)

    def add(self, chunk: np.ndarray, envs: Environments = None, delay: int = 0) -> None:
        """Take in a chunk whose first action is for the current step; for callers who keep time themselves.

        Args:
            chunk: as from ``predict``.
            envs: the environments it is for; None for all.
            delay: steps that its computation will have taken: the older plan goes on for as long.

        Raises:
            ValueError: as `step`.
        """
        self._check(chunk, envs)
        if chunk.ndim == 4:
            plan, covered = self._timeline.plan(envs)
            chunk = most_coherent(chunk, plan, covered) if plan.size else chunk[0]
        if not len(self._due_at):
            self._start(len(chunk))
        used = chunk[:, : self.settings.n_action_steps]
        smooth = moving_mean(used, self.settings.smoothing_steps, self.settings.gripper_dims)
        self._timeline.add(smooth, envs, delay)
        self._schedule(envs, self._step + self.settings.replan_interval)
        if self.on_chunk is not None:
            self.on_chunk(ChunkEvent(self._step, envs, chunk))

    def add_late(self, chunk: np.ndarray, age: int) -> None:
        """Take in a chunk for all environments, whose first action was for ``age`` steps ago.

        What comes of it is what ``latency_steps=age`` says: the same as `add` with that delay in time.

        Args:
            chunk: as from ``predict``.
            age: control steps since its observation, fewer than ``n_action_steps``.

        Raises:
            ValueError: as `step`.
        """
        self._step -= age
        try:
            with self._timeline.rewound(age):
                self.add(chunk, None, age)
        finally:
            self._step += age

    def pop(self) -> np.ndarray:
        """The action (B, A) of the current step; the last one is held if no chunk covers it."""
        action = self._timeline.pop()
        self._step += 1
        return action

    def plan(self, envs: Environments = None) -> tuple[np.ndarray, np.ndarray]:
        """What would be executed without a further chunk (n, T, A), and the steps it covers (r, T).

        Both are empty before the first chunk. Covered has one row for all environments, or one for each.
        """
        return self._timeline.plan(envs)

    def _check(self, chunk: np.ndarray, envs: Environments) -> None:
        *_, n_chunks, length, n_dims = chunk.shape
        needed = self.settings.n_action_steps
        if length < needed:
            raise ValueError(f"a chunk of {length} actions is too short for n_action_steps={needed}")
        expected = len(self._due_at if envs is None else envs) or n_chunks
        if n_chunks != expected:
            raise ValueError(f"{n_chunks} chunks for {expected} environments")
        if envs is not None and not len(self._due_at):
            raise ValueError("the first chunks of a rollout must be for all environments: envs=None")
        if max(self.settings.gripper_dims, default=-1) >= n_dims:
            dims = list(self.settings.gripper_dims)
            raise ValueError(f"gripper_dims={dims} go beyond the {n_dims} action dimensions")


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
