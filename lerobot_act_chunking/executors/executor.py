"""Work that is shared among workers, any of which may die."""

import pickle
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass
from queue import PriorityQueue, SimpleQueue
from threading import Thread
from typing import Any, Protocol, Self

from lerobot_act_chunking.errors import WorkerError

type Places = Callable[[str], AbstractContextManager[str]]
"""Where a worker finds one of the folders that travel with the work, as long as the context lasts."""
type Open[T, A] = Callable[[Places], AbstractContextManager[Callable[[T], A]]]
"""Prepares a worker; its context gives what does one item. It is pickled, and so are items and results."""

ATTEMPTS = 3
"""Workers that may die with the same item before it is given up."""
_END = -1


class Executor[T, A](Protocol):
    """Does items. A context manager: leaving it ends what is still running."""

    @property
    def workers(self) -> int:
        """How many items are done at a time."""
        ...

    @property
    def in_flight(self) -> int:
        """Items that were submitted and whose results were not taken."""
        ...

    def submit(self, item: T) -> None:
        """Ask for an item; those that were asked for first are begun first."""
        ...

    def result(self) -> tuple[T, A]:
        """Wait for the next item that is done, in any order; what it raised is raised here."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exception: object) -> None: ...


def each_done[T, A](
    executor: Executor[T, A], items: Iterable[T], may_begin: Callable[[], bool] = lambda: True
) -> Iterator[tuple[T, A]]:
    """Do items while ``may_begin`` says so, with as many in flight as there are workers; in any order."""
    waiting = deque(items)
    while True:
        while waiting and executor.in_flight < executor.workers and may_begin():
            executor.submit(waiting.popleft())
        if not executor.in_flight:
            return
        yield executor.result()


class Inline[T, A]:
    """Does each item in this thread when its result is asked for.

    Args:
        open_: as `Open`; called at the first item.
    """

    workers = 1

    def __init__(self, open_: Open[T, A]) -> None:
        self._open, self._resources = open_, ExitStack()
        self._items: deque[T] = deque()
        self._answer: Callable[[T], A] | None = None

    @property
    def in_flight(self) -> int:
        """Items whose results were not taken."""
        return len(self._items)

    def submit(self, item: T) -> None:
        """Ask for an item."""
        self._items.append(item)

    def result(self) -> tuple[T, A]:
        """Do the item that was asked for first."""
        if self._answer is None:
            self._answer = self._resources.enter_context(self._open(nullcontext))
        item = self._items.popleft()
        return item, self._answer(item)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._resources.close()


class WorkerDiedError(Exception):
    """A worker is gone, and with it what it was doing."""


class Worker[T, A](Protocol):
    """Does one item at a time in a process of its own, here or elsewhere."""

    def ready(self) -> None:
        """Wait until it can begin.

        Raises:
            WorkerDiedError: it never will.
            ConfigurationError: it must not.
        """
        ...

    def answer(self, item: T) -> A:
        """Do an item; what it raises is raised here.

        Raises:
            WorkerDiedError: it is gone, and the item is to be done again.
        """
        ...

    def end(self) -> None:
        """End it, whatever it is doing; may be called from any thread, and again."""
        ...


class Workers[T, A]:
    """Does items in workers; those of a worker that died are done again by another.

    Args:
        start: begins a worker.
        n: how many.
    """

    def __init__(self, start: Callable[[], Worker[T, A]], n: int) -> None:
        self.workers, self.in_flight = n, 0
        self._start, self._closing = start, False
        self._deaths, self._submitted = Counter[int](), 0
        self._waiting: PriorityQueue[tuple[int, Any]] = PriorityQueue()
        self._finished: SimpleQueue[tuple[Any, Any]] = SimpleQueue()
        self._live = [start() for _ in range(n)]
        self._threads = [Thread(target=self._serve, args=(place,), daemon=True) for place in range(n)]
        for thread in self._threads:
            thread.start()

    def submit(self, item: T) -> None:
        """Ask for an item."""
        self.in_flight += 1
        self._waiting.put((self._submitted, item))
        self._submitted += 1

    def result(self) -> tuple[T, A]:
        """Wait for the next item that is done.

        Raises:
            WorkerError: workers died again and again.
        """
        item, answer = self._finished.get()
        self.in_flight -= 1
        return item, taken(answer)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._closing = True
        for worker in self._live:
            worker.end()
            self._waiting.put((_END, None))
        for thread in self._threads:
            thread.join()

    def _serve(self, place: int) -> None:
        """One worker's work, and that of those who follow it."""
        try:
            while self._is_ready(place):
                number, item = self._waiting.get()
                if number == _END:
                    return
                self._do(place, number, item)
        except Exception as error:
            self._finished.put((None, Failure(error)))
        finally:
            self._live[place].end()

    def _is_ready(self, place: int) -> bool:
        """Whether there is a worker, or another one in its place; none is needed in the end."""
        for attempt in range(ATTEMPTS):
            if self._closing:
                return False
            try:
                self._live[place].ready()
            except WorkerDiedError as error:
                if attempt + 1 == ATTEMPTS and not self._closing:
                    raise _given_up(error) from error
                self._replace(place)
            else:
                return True
        return False

    def _do(self, place: int, number: int, item: T) -> None:
        try:
            self._finished.put((item, self._live[place].answer(item)))
        except WorkerDiedError as error:
            if self._closing:
                return
            self._deaths[number] += 1
            if self._deaths[number] == ATTEMPTS:
                self._finished.put((item, Failure(_given_up(error))))
            else:
                self._waiting.put((number, item))
            self._replace(place)
        except Exception as error:
            self._finished.put((item, Failure(error)))

    def _replace(self, place: int) -> None:
        self._live[place].end()
        if not self._closing:
            self._live[place] = self._start()


@dataclass(frozen=True)
class Failure:
    """What an item raised, on its way to whoever asked for it."""

    error: Exception


def answered[T, A](answer: Callable[[T], A], item: T) -> A | Failure:
    """Do an item in a worker; an error that cannot be pickled becomes one that can."""
    try:
        return answer(item)
    except Exception as error:
        return failure(error)


def failure(error: Exception) -> Failure:
    """An error that travels: one that cannot be pickled is replaced by its words."""
    try:
        pickle.loads(pickle.dumps(error))  # noqa: S301 (our own)
    except Exception:
        return Failure(RuntimeError(f"{type(error).__name__}: {error}"))
    return Failure(error)


def taken[A](answer: A | Failure) -> A:
    """An answer, or the error that came in its place, raised."""
    if isinstance(answer, Failure):
        raise answer.error
    return answer


def _given_up(last: WorkerDiedError) -> WorkerError:
    return WorkerError(
        f"{ATTEMPTS} workers died one after the other at the same work ({last}; out of memory, or a script "
        "that starts workers without `if __name__ == '__main__':`?): run the same command again, with fewer "
        "workers if memory is short; what is finished is kept"
    )
