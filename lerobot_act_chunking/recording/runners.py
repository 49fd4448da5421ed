"""Running attempts, here or in worker processes; either way each ends as a file in the episode store."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing.connection import Connection, wait
from typing import Protocol, Self, cast

from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.recording.episode import EpisodeSource, check_episode
from lerobot_act_chunking.recording.staging import EpisodeStore
from lerobot_act_chunking.worker_processes import WorkerProcesses


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
        self._attempt: Callable[[int], tuple[int, bool]] | None = None

    def submit(self, seed: int) -> None:
        """Nothing to do ahead of time."""

    def succeeded(self, seed: int) -> bool:
        """Run the attempt."""
        if self._attempt is None:
            self._attempt = self._resources.enter_context(_attempts(self._source, self._store))
        return self._attempt(seed)[1]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._resources.close()


class WorkerPool:
    """Runs attempts in ``workers`` fresh processes."""

    def __init__(self, source: EpisodeSource, store: EpisodeStore, workers: int) -> None:
        self._workers = WorkerProcesses(partial(_attempts, source, store), workers, _worker_died)
        self._outcomes: dict[int, bool] = {}
        self._queued = dict.fromkeys(self._workers.connections, 0)

    def submit(self, seed: int) -> None:
        """Queue the attempt with the worker that has least to do."""
        connection = min(self._queued, key=self._queued.__getitem__)
        self._workers.send(connection, seed)
        self._queued[connection] += 1

    def succeeded(self, seed: int) -> bool:
        """Wait for the attempt; a worker's error is raised here."""
        while seed not in self._outcomes:
            for ready in wait(list(self._queued)):
                connection = cast(Connection, ready)
                finished, success = self._workers.receive(connection)
                self._outcomes[finished] = success
                self._queued[connection] -= 1
        return self._outcomes.pop(seed)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._workers.__exit__()


@contextmanager
def _attempts(source: EpisodeSource, store: EpisodeStore) -> Iterator[Callable[[int], tuple[int, bool]]]:
    """Runs the attempt of a seed: the seed, and whether it succeeded."""
    with source.open() as play:

        def attempt(seed: int) -> tuple[int, bool]:
            episode = play(seed)
            if episode.success:
                check_episode(episode, source.format)
            store.save(episode)
            return seed, episode.success

        yield attempt


def _worker_died() -> DatasetError:
    return DatasetError(
        "a recording worker died (out of memory, or a script that starts workers without "
        "`if __name__ == '__main__':`); finished episodes are safe: "
        "run again, with fewer workers if memory is short"
    )
