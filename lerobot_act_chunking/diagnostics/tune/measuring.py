"""Episodes of candidates, here or in worker processes."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol, Self, cast

from lerobot_act_chunking.diagnostics.core.rollouts import roll_out
from lerobot_act_chunking.diagnostics.tune.candidates import Candidate
from lerobot_act_chunking.diagnostics.tune.racing import Cell
from lerobot_act_chunking.diagnostics.tune.subject import Subject, execute
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.loading import LoadedPolicy

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
    """Runs cells in fresh processes, which end when the race does, and by themselves if it is killed."""

    def __init__(self, episodes: Episodes, workers: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._idle: list[Connection] = []
        self._processes = []
        for _ in range(workers):
            ours, theirs = context.Pipe()
            process = context.Process(target=_work, args=(theirs, episodes, workers), daemon=True)
            process.start()
            theirs.close()
            self._processes.append(process)
            self._idle.append(cast(Connection, ours))

    def run(self, cells: Sequence[CandidateCell], may_begin: Callable[[], bool]) -> Iterator[Outcome]:
        """Give each worker the next cell as soon as it has finished one."""
        waiting, running = list(cells), dict[Connection, CandidateCell]()
        while True:
            while self._idle and waiting and may_begin():
                connection, cell = self._idle.pop(), waiting.pop(0)
                connection.send(cell)
                running[connection] = cell
            if not running:
                return
            for ready in wait(list(running)):
                connection = cast(Connection, ready)
                yield running.pop(connection), self._answer(connection)

    def _answer(self, connection: Connection) -> list[bool]:
        try:
            answer = connection.recv()
        except (EOFError, OSError) as error:
            raise ConfigurationError(
                "a worker process died, perhaps for want of memory: run the same command with --workers 1; "
                "finished episodes are kept"
            ) from error
        if isinstance(answer, BaseException):
            raise answer
        self._idle.append(connection)
        return answer

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            process.join()


def _work(connection: Connection, episodes: Episodes, workers: int) -> None:
    """A worker's life: a cell comes, its outcome goes, until the race ends it or is gone."""
    import torch

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the race decides
    torch.set_num_threads(max(1, (os.cpu_count() or 1) // workers))
    try:
        policy = episodes.subject.load()
        while True:
            connection.send(episodes.play(policy, connection.recv()))
    except EOFError:
        return
    except Exception as error:
        with suppress(OSError):  # nobody listens when the race was killed
            connection.send(error)
