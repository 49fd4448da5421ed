"""Workers that are processes of this machine."""

import multiprocessing
import signal
from contextlib import nullcontext, suppress
from multiprocessing.connection import Connection
from typing import cast

from lerobot_act_chunking.executors.executor import Open, WorkerDiedError, answered, failure, taken


class LocalWorker[T, A]:
    """A fresh process that answers items over a pipe of its own.

    It ends at once when this process is interrupted, and by itself after its current item when this process
    is killed: its pipe breaks.

    Args:
        open_: as `Open`; called in the process.
    """

    def __init__(self, open_: Open[T, A]) -> None:
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs, open_), daemon=True)
        self.process.start()
        theirs.close()
        self._connection = cast(Connection, ours)

    def ready(self) -> None:
        """Nothing to wait for: its first item waits in the pipe."""

    def answer(self, item: T) -> A:
        """Do an item in the process.

        Raises:
            WorkerDiedError: it is gone.
        """
        with suppress(OSError):  # it is gone; what it had to say is still in the pipe
            self._connection.send(item)
        try:
            answer = self._connection.recv()
        except (EOFError, OSError) as error:
            raise WorkerDiedError("its process is gone") from error
        return taken(answer)

    def end(self) -> None:
        """End the process."""
        self.process.terminate()
        self.process.join()


def _work[T, A](connection: Connection, open_: Open[T, A]) -> None:
    """A worker's life: an item comes, its answer goes, until the other side ends it or is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the other side decides
    try:
        with open_(nullcontext) as answer, suppress(EOFError, OSError):  # the other side is gone
            while True:
                connection.send(answered(answer, connection.recv()))
    except Exception as error:
        with suppress(OSError):
            connection.send(failure(error))
