"""Tasks of a measurement, done here or in worker processes."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from multiprocessing.connection import Connection, wait
from typing import Protocol, Self, cast

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.worker_processes import WorkerProcesses

type Open[T, A] = Callable[[], AbstractContextManager[Callable[[T], A]]]
"""Prepares a process for its work; the context gives what does one task."""


class Tasks[T, A](Protocol):
    """Does tasks. A context manager: leaving it ends what is still running."""

    def run(self, tasks: Sequence[T], may_begin: Callable[[], bool]) -> Iterator[tuple[T, A]]:
        """Do tasks while ``may_begin`` says so; those begun are finished. In any order."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exception: object) -> None: ...


class InlineTasks[T, A]:
    """Does one task after the other, in their order.

    Args:
        answer: does one.
    """

    def __init__(self, answer: Callable[[T], A]) -> None:
        self._answer = answer

    def run(self, tasks: Sequence[T], may_begin: Callable[[], bool]) -> Iterator[tuple[T, A]]:
        """Do tasks in their order."""
        for task in tasks:
            if not may_begin():
                return
            yield task, self._answer(task)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        pass


class WorkerTasks[T, A]:
    """Does tasks in fresh processes, which share the cores.

    Args:
        open_: as `Open`; called in each process.
        workers: how many processes.
    """

    def __init__(self, open_: Open[T, A], workers: int) -> None:
        self._workers = WorkerProcesses(partial(_sharing_cores, open_, workers), workers, _worker_died)
        self._idle = list(self._workers.connections)

    def run(self, tasks: Sequence[T], may_begin: Callable[[], bool]) -> Iterator[tuple[T, A]]:
        """Give each worker the next task as soon as it has finished one."""
        waiting, running = list(tasks), dict[Connection, T]()
        while True:
            while self._idle and waiting and may_begin():
                connection, task = self._idle.pop(), waiting.pop(0)
                self._workers.send(connection, task)
                running[connection] = task
            if not running:
                return
            for ready in wait(list(running)):
                connection = cast(Connection, ready)
                answer = self._workers.receive(connection)
                self._idle.append(connection)
                yield running.pop(connection), answer

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._workers.__exit__()


@contextmanager
def _sharing_cores[T, A](open_: Open[T, A], workers: int) -> Iterator[Callable[[T], A]]:
    import torch

    torch.set_num_threads(max(1, (os.cpu_count() or 1) // workers))
    with open_() as answer:
        yield answer


def _worker_died() -> ConfigurationError:
    return ConfigurationError(
        "a worker process died, perhaps for want of memory: run the same command with --workers 1; "
        "finished episodes are kept"
    )
