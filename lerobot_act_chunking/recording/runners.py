"""Running attempts, here or in worker processes; either way each ends as a file in the episode store."""

import multiprocessing
import signal
from collections.abc import Callable
from contextlib import ExitStack, suppress
from multiprocessing.connection import Connection, wait
from typing import Protocol, Self, cast

from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.recording.episode import DatasetFormat, Episode, EpisodeSource, check_episode
from lerobot_act_chunking.recording.staging import EpisodeStore


class Runner(Protocol):
    """Runs attempts. A context manager: leaving it ends what is still running."""

    def submit(self, seed: int) -> None:
        """Ask for the attempt of ``seed``."""
        ...

    def succeeded(self, seed: int) -> bool:
        """Whether the attempt of ``seed``, asked for before, succeeded; waits for its end."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exception: object) -> None: ...


def make_runner(source: EpisodeSource, store: EpisodeStore, workers: int) -> Runner:
    """One worker runs here, more in processes of their own."""
    return InlineRunner(source, store) if workers == 1 else WorkerPool(source, store, workers)


class InlineRunner:
    """Runs each attempt when its outcome is asked for."""

    def __init__(self, source: EpisodeSource, store: EpisodeStore) -> None:
        self._source, self._store = source, store
        self._resources = ExitStack()
        self._play: Callable[[int], Episode] | None = None

    def submit(self, seed: int) -> None:
        """Nothing to do ahead of time."""

    def succeeded(self, seed: int) -> bool:
        """Run the attempt."""
        if self._play is None:
            self._play = self._resources.enter_context(self._source.open())
        return _attempt(self._play, self._source.format, self._store, seed)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._resources.close()


class WorkerPool:
    """Runs attempts in ``workers`` fresh processes.

    Unlike an executor's, these workers end at once when the recorder is interrupted, and by themselves after
    their current attempt when it is killed: their pipe to it breaks.
    """

    def __init__(self, source: EpisodeSource, store: EpisodeStore, workers: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._outcomes: dict[int, bool] = {}
        self._queued: dict[Connection, int] = {}
        self._processes = []
        for _ in range(workers):
            ours, theirs = context.Pipe()
            process = context.Process(target=_work, args=(theirs, source, store), daemon=True)
            process.start()
            theirs.close()
            self._processes.append(process)
            self._queued[cast(Connection, ours)] = 0

    def submit(self, seed: int) -> None:
        """Queue the attempt with the worker that has least to do."""
        connection = min(self._queued, key=self._queued.__getitem__)
        try:
            connection.send(seed)
        except OSError as error:
            raise _worker_died() from error
        self._queued[connection] += 1

    def succeeded(self, seed: int) -> bool:
        """Wait for the attempt; a worker's error is raised here."""
        while seed not in self._outcomes:
            for connection in wait(list(self._queued)):
                self._receive(cast(Connection, connection))
        return self._outcomes.pop(seed)

    def _receive(self, connection: Connection) -> None:
        try:
            answer = connection.recv()
        except (EOFError, OSError) as error:
            raise _worker_died() from error
        if isinstance(answer, BaseException):
            raise answer
        seed, success = answer
        self._outcomes[seed] = success
        self._queued[connection] -= 1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            process.join()


def _work(connection: Connection, source: EpisodeSource, store: EpisodeStore) -> None:
    """A worker's life: a seed comes, an outcome goes, until the recorder ends it or is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the recorder decides
    try:
        with source.open() as play:
            while True:
                seed = connection.recv()
                connection.send((seed, _attempt(play, source.format, store, seed)))
    except EOFError:
        return
    except Exception as error:
        with suppress(OSError):  # nobody listens when the recorder was killed
            connection.send(error)


def _attempt(play: Callable[[int], Episode], form: DatasetFormat, store: EpisodeStore, seed: int) -> bool:
    episode = play(seed)
    if episode.success:
        check_episode(episode, form)
    store.save(episode)
    return episode.success


def _worker_died() -> DatasetError:
    return DatasetError(
        "a recording worker died (out of memory, or a script that starts workers without "
        "`if __name__ == '__main__':`); finished episodes are safe: "
        "run again, with fewer workers if memory is short"
    )
