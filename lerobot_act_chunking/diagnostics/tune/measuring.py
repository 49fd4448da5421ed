"""Episodes of candidates, here or in worker processes."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol, Self, cast

from lerobot_act_chunking.diagnostics.core.rollouts import roll_out
from lerobot_act_chunking.diagnostics.tune.candidates import Candidate
from lerobot_act_chunking.diagnostics.tune.racing import Cell
from lerobot_act_chunking.diagnostics.tune.subject import Subject, execute
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.loading import LoadedPolicy
from lerobot_act_chunking.worker_processes import WorkerProcesses

CandidateCell = Cell[Candidate]
Outcome = tuple[CandidateCell, list[bool]]


@dataclass(frozen=True)
class Episodes:
    """Which episodes are run.

    Attributes:
        subject: whose.
        env_config: where; of any LeRobot environment.
        seed: of the first.
    """

    subject: Subject
    env_config: Any
    seed: int

    def play(self, policy: LoadedPolicy, cell: CandidateCell) -> list[bool]:
        """Which of a cell's episodes succeed."""
        execute(policy, cell.candidate)
        first = self.seed + cell.start
        rollouts = roll_out(policy, self.env_config, range(first, first + cell.n), log_chunks=False)
        return [rollout.success for rollout in rollouts]


class Runner(Protocol):
    """Runs cells. A context manager: leaving it ends what is still running."""

    def run(self, cells: Sequence[CandidateCell], may_begin: Callable[[], bool]) -> Iterator[Outcome]:
        """Run cells while ``may_begin`` says so; those begun are finished."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exception: object) -> None: ...


def make_runner(episodes: Episodes, workers: int, policy: LoadedPolicy) -> Runner:
    """One worker runs here with the policy that is loaded, more load it in processes of their own."""
    return InlineRunner(episodes, policy) if workers == 1 else WorkerPool(episodes, workers)


class InlineRunner:
    """Runs one cell after the other."""

    def __init__(self, episodes: Episodes, policy: LoadedPolicy) -> None:
        self._episodes, self._policy = episodes, policy

    def run(self, cells: Sequence[CandidateCell], may_begin: Callable[[], bool]) -> Iterator[Outcome]:
        """Run cells in their order."""
        for cell in cells:
            if not may_begin():
                return
            yield cell, self._episodes.play(self._policy, cell)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        pass


class WorkerPool:
    """Runs cells in fresh processes."""

    def __init__(self, episodes: Episodes, workers: int) -> None:
        self._workers = WorkerProcesses(partial(_player, episodes, workers), workers, _worker_died)
        self._idle = list(self._workers.connections)

    def run(self, cells: Sequence[CandidateCell], may_begin: Callable[[], bool]) -> Iterator[Outcome]:
        """Give each worker the next cell as soon as it has finished one."""
        waiting, running = list(cells), dict[Connection, CandidateCell]()
        while True:
            while self._idle and waiting and may_begin():
                connection, cell = self._idle.pop(), waiting.pop(0)
                self._workers.send(connection, cell)
                running[connection] = cell
            if not running:
                return
            for ready in wait(list(running)):
                connection = cast(Connection, ready)
                successes = self._workers.receive(connection)
                self._idle.append(connection)
                yield running.pop(connection), successes

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._workers.__exit__()


@contextmanager
def _player(episodes: Episodes, workers: int) -> Iterator[Callable[[CandidateCell], list[bool]]]:
    """Runs a cell with a policy of this process's own."""
    import torch

    torch.set_num_threads(max(1, (os.cpu_count() or 1) // workers))
    yield partial(episodes.play, episodes.subject.load())


def _worker_died() -> ConfigurationError:
    return ConfigurationError(
        "a worker process died, perhaps for want of memory: run the same command with --workers 1; "
        "finished episodes are kept"
    )
