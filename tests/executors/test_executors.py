"""Work shared among workers: nothing is lost and nothing is doubled, whichever of them die, whenever."""

import os
import signal
import time
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest

from lerobot_act_chunking.errors import ConfigurationError, WorkerError
from lerobot_act_chunking.executors import each_done, open_executor
from lerobot_act_chunking.executors.executor import ATTEMPTS, WorkerDiedError, Workers
from lerobot_act_chunking.executors.local import LocalWorker


class Fake:
    """A worker without a process, which dies at these calls of all workers' or refuses to begin."""

    def __init__(self, calls, dying=(), refusing=None):
        self.calls, self.dying, self.refusing, self.ended = calls, dying, refusing, False

    def ready(self):
        if self.refusing is not None:
            raise self.refusing

    def answer(self, item):
        self.calls.append(item)
        if len(self.calls) - 1 in self.dying or self.ended:
            raise WorkerDiedError
        if item < 0:
            raise ValueError(f"{item} is cursed")
        return 2 * item

    def end(self):
        self.ended = True


def opened(n=1, **given):
    calls = []
    return calls, Workers(partial(Fake, calls, **given), n)


@pytest.mark.parametrize("dying", [(), (0,), (1, 2), (0, 2, 4, 6)])
@pytest.mark.parametrize("n", [1, 3])
def test_items_of_dead_workers_are_done_again_and_nothing_is_doubled(n, dying):
    calls, workers = opened(n, dying=dying)
    with workers:
        done = list(each_done(workers, range(9)))
        assert workers.in_flight == 0
    assert sorted(done) == [(item, 2 * item) for item in range(9)]
    assert len(calls) == 9 + len(dying)


def test_an_item_that_kills_its_workers_is_given_up():
    calls, workers = opened(dying=range(1, 99))
    with workers, pytest.raises(WorkerError, match="3 workers died one after the other at the same work"):
        list(each_done(workers, range(4)))
    assert calls.count(1) == ATTEMPTS


@pytest.mark.parametrize("error", [ConfigurationError("other versions"), WorkerDiedError()])
def test_workers_that_cannot_begin_are_told(error):
    _, workers = opened(refusing=error)
    told = "3 workers died" if isinstance(error, WorkerDiedError) else "other versions"
    with workers, pytest.raises((ConfigurationError, WorkerError), match=told):
        list(each_done(workers, [1]))


def test_no_more_is_in_flight_than_there_are_workers_and_nothing_begins_after_the_end():
    _, workers = opened(2)
    begun = []
    with workers:
        for _ in each_done(workers, range(9), lambda: len(begun) < 5 and begun.append(0) is None):
            assert workers.in_flight <= 1
    assert len(begun) == 5


def test_what_an_item_raises_is_raised_here():
    _, workers = opened()
    with workers, pytest.raises(ValueError, match="-1 is cursed"):
        list(each_done(workers, [1, -1]))


@contextmanager
def squares(places):
    yield square


def square(item):
    """Of a number; of a text that process's id, after it has died once where its file is not there yet."""
    if isinstance(item, int):
        return item**2
    if not Path(item).exists():
        Path(item).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


class UnspeakableError(Exception):
    def __init__(self, one, two):
        super().__init__(f"{one} and {two}")


@contextmanager
def unspeakable(places):
    raise UnspeakableError(1, 2)
    yield


def test_processes_answer_die_and_are_replaced(tmp_path):
    with open_executor(squares, 2) as executor:
        found = dict(each_done(executor, [*range(5), str(tmp_path / "died")]))
    assert {item: found[item] for item in range(5)} == {item: item**2 for item in range(5)}
    assert found[str(tmp_path / "died")] != os.getpid()


def test_one_worker_is_this_process_and_does_nothing_ahead():
    with open_executor(squares, 1) as executor:
        executor.submit(__file__)
        executor.submit(3)
        assert [executor.result(), executor.result()] == [(__file__, os.getpid()), (3, 9)]


def test_a_process_leaves_ctrl_c_to_this_one_and_says_why_it_cannot_begin():
    worker, mute = LocalWorker(squares), LocalWorker(unspeakable)
    assert worker.answer(3) == 9
    os.kill(worker.process.pid, signal.SIGINT)
    time.sleep(0.1)
    assert worker.answer(4) == 16
    with pytest.raises(RuntimeError, match="UnspeakableError: 1 and 2"):
        mute.answer(3)
    for each in (worker, mute):
        each.end()
        assert not each.process.is_alive()
