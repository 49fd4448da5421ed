"""Attempts that are played by workers, and kept in the episode store by this process as they end."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Protocol

from lerobot_act_chunking.executors import Cluster, Executor, Places, open_executor
from lerobot_act_chunking.recording.episode import Episode, EpisodeSource, check_episode
from lerobot_act_chunking.recording.staging import EpisodeStore


class Runner(Protocol):
    """Runs attempts."""

    def submit(self, seed: int) -> None:
        """Ask for the attempt of ``seed``."""
        ...

    def succeeded(self, seed: int) -> bool:
        """Whether the attempt of ``seed``, asked for before, succeeded; waits for its end."""
        ...


class StoringRunner:
    """Has attempts played by an executor, and stores what comes back.

    Args:
        executor: of `open_attempts`.
        store: for the episodes.
    """

    def __init__(self, executor: Executor[int, Episode], store: EpisodeStore) -> None:
        self._executor, self._store = executor, store
        self._outcomes: dict[int, bool] = {}

    def submit(self, seed: int) -> None:
        """Queue the attempt."""
        self._executor.submit(seed)

    def succeeded(self, seed: int) -> bool:
        """Store attempts that end until it is this one's turn; a worker's error is raised here."""
        while seed not in self._outcomes:
            _, episode = self._executor.result()
            self._store.save(episode)
            self._outcomes[episode.seed] = episode.success
        return self._outcomes.pop(seed)


def open_attempts(
    source: EpisodeSource, workers: int, cluster: Cluster | None = None
) -> Executor[int, Episode]:
    """What plays the attempts of seeds; one worker is this process."""
    return open_executor(partial(_attempts, source), workers, cluster)


@contextmanager
def _attempts(source: EpisodeSource, _: Places) -> Iterator[Callable[[int], Episode]]:
    """Plays the attempt of a seed; of a failure only that comes back."""
    with source.open() as play:

        def attempt(seed: int) -> Episode:
            episode = play(seed)
            if not episode.success:
                return replace(episode, arrays={}, videos={})
            check_episode(episode, source.format)
            return episode

        yield attempt
