"""Chunks that are computed while the actions before them are executed."""

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from act_chunking_runtime.errors import ConfigurationError
from act_chunking_runtime.executor import ChunkExecutor, Prepare
from act_chunking_runtime.settings import ExecutionSettings
from act_chunking_runtime.timeline import Environments

REMEMBERED = 10  # chunks, by whose longest delay the next one is expected
PATIENCE = 3  # chunks in a row that come too late: one may, because everything is slow once


@dataclass(frozen=True)
class _Awaited:
    """A chunk that is being computed, and the step of its observation."""

    future: "Future[np.ndarray]"
    step: int


class BackgroundExecutor(ChunkExecutor):
    """Executes chunks as `ChunkExecutor`, but computes them in a thread, so that no control step waits.

    A chunk that comes d steps after its observation is taken in as one with ``latency_steps=d``. Only the
    first one of a rollout is waited for, since there is nothing to execute before it.

    Attributes:
        delays: of the last chunks [control steps].
    """

    def __init__(self, settings: ExecutionSettings):
        self.delays: deque[int] = deque(maxlen=REMEMBERED)
        self._awaited: _Awaited | None = None
        self._n_late = 0
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="chunk")
        super().__init__(settings)

    def _start(self, batch_size: int) -> None:
        self._forget_awaited()
        self._n_late = 0
        self.delays.clear()
        super()._start(batch_size)

    def clear(self, envs: Environments = None) -> None:
        """Drop the actions that wait, and the chunk that is being computed; see `ChunkExecutor.clear`."""
        self._forget_awaited()
        super().clear(envs)

    def _forget_awaited(self) -> None:
        """Wait until nothing is computed any more, so that draws and histories can begin anew."""
        if self._awaited is not None:
            if not self._awaited.future.cancel():
                self._awaited.future.exception()
            self._awaited = None

    def advance(self, prepare: Prepare, batch_size: int) -> np.ndarray:
        """The action (B, A) of this control step; a chunk that is due begins to be computed.

        Args:
            prepare: called only if a chunk is due and none is being computed.
            batch_size: number of environments, one: a robot.

        Raises:
            ConfigurationError: several environments, or `PATIENCE` chunks in a row that come too late.
        """
        if batch_size != 1:
            raise ConfigurationError(
                f"background=true is for one robot, not for {batch_size} environments: set background=false, "
                "and latency_steps to what a chunk takes to compute"
            )
        if batch_size != len(self._due_at):
            self._start(batch_size)
        self._take_in()
        if self._awaited is None and self._step >= self._first_due:
            if not self.plan()[0].size:
                self.add(prepare(None, 0)())
            else:
                compute = prepare(None, max(self.delays, default=self.settings.latency_steps))
                self._awaited = _Awaited(self._thread.submit(compute), self._step)
        return self.pop()

    def _take_in(self) -> None:
        """Take in the chunk that was computed in the meantime, if one was."""
        if self._awaited is None or not self._awaited.future.done():
            return None
        awaited, self._awaited = self._awaited, None
        chunk, age = awaited.future.result(), self._step - awaited.step
        self.delays.append(age)
        if age < self.settings.n_action_steps:
            self._n_late = 0
            return self.add_late(chunk, age)
        self._n_late += 1
        if self._n_late >= PATIENCE:
            used = self.settings.n_action_steps
            raise ConfigurationError(
                f"{PATIENCE} chunks in a row took longer to compute than the n_action_steps={used} control "
                "steps that are used of each, so the robot does not move: let it wait for each chunk "
                "(background=false), or compute faster (a GPU, fewer inference steps, a smaller policy)"
            )
        return None


def make_executor(settings: ExecutionSettings) -> ChunkExecutor:
    """The executor of these settings."""
    return BackgroundExecutor(settings) if settings.background else ChunkExecutor(settings)
