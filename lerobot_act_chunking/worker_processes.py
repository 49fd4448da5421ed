"""Fresh processes that answer tasks, each over a pipe of its own."""

import multiprocessing
import signal
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from multiprocessing.connection import Connection
from typing import Any, Self, cast

type Opened = AbstractContextManager[Callable[[Any], Any]]


class WorkerProcesses:
    """Processes that answer tasks. A context manager: leaving it ends what is still running.

    Unlike an executor's, these workers end at once when this process is interrupted, and by themselves after
    their current task when it is killed: their pipe to it breaks.

    Args:
        open_: called in each worker; its context gives the function that answers a task.
        n: number of workers.
        died: the error to raise where a worker is gone.
    """

    def __init__(self, open_: Callable[[], Opened], n: int, died: Callable[[], Exception]) -> None:
        self._died = died
        self.processes = []
        self.connections: list[Connection] = []
        context = multiprocessing.get_context("spawn")
        for _ in range(n):
            ours, theirs = context.Pipe()
            process = context.Process(target=_work, args=(theirs, open_), daemon=True)
            process.start()
            theirs.close()
            self.processes.append(process)
            self.connections.append(cast(Connection, ours))

    def send(self, connection: Connection, task: Any) -> None:
        """Give a worker one more task."""
        try:
            connection.send(task)
        except OSError as error:
            raise self._died() from error

    def receive(self, connection: Connection) -> Any:
        """A worker's next answer, which is awaited; its error is raised here."""
        try:
            answer = connection.recv()
        except (EOFError, OSError) as error:
            raise self._died() from error
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        for process in self.processes:
            process.terminate()
        for process in self.processes:
            process.join()


def _work(connection: Connection, open_: Callable[[], Opened]) -> None:
    """A worker's life: a task comes, its answer goes, until the other side ends it or is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the other side decides
    try:
        with open_() as answer:
            while True:
                connection.send(answer(connection.recv()))
    except EOFError:
        return
    except Exception as error:
        with suppress(OSError):  # nobody listens when the other side was killed
            connection.send(error)
