import pytest

from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.recording.attempts import MAX_FAILURES_IN_A_ROW, AttemptQueue


class Runner:
    """Remembers what was asked for; fails the given seeds."""

    def __init__(self, failing=()):
        self.failing, self.submitted, self.waited = failing, [], []

    def submit(self, seed):
        self.submitted.append(seed)

    def succeeded(self, seed):
        self.waited.append(seed)
        return seed not in self.failing

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        pass


def test_without_failures_just_what_is_wanted_is_played():
    runner = Runner()
    assert list(AttemptQueue(runner, {}, 10, 4, ahead=9)) == [(seed, True) for seed in (10, 11, 12, 13)]
    assert runner.submitted == runner.waited == [10, 11, 12, 13]


def test_a_failure_is_made_up_for_by_the_next_seed():
    runner = Runner(failing={1, 2})
    outcomes = list(AttemptQueue(runner, {}, 0, 3, ahead=2))
    assert outcomes == [(0, True), (1, False), (2, False), (3, True), (4, True)]
    assert runner.submitted == [0, 1, 2, 3, 4]


def test_attempts_are_asked_for_ahead_at_once():
    runner = Runner()
    queue = AttemptQueue(runner, {}, 0, 9, ahead=4)
    assert runner.submitted == [0, 1, 2, 3]
    next(queue)
    assert runner.submitted == [0, 1, 2, 3, 4]


def test_known_outcomes_are_not_played_again():
    runner = Runner()
    outcomes = list(AttemptQueue(runner, {0: True, 1: False, 3: True, 99: True}, 0, 4, ahead=3))
    assert outcomes == [(0, True), (1, False), (2, True), (3, True), (4, True)]
    assert runner.submitted == [2, 4]


def test_an_expert_that_keeps_failing_is_an_error():
    runner = Runner(failing=range(1000))
    queue = AttemptQueue(runner, {}, 5, 3, ahead=1)
    assert MAX_FAILURES_IN_A_ROW == 20
    with pytest.raises(DatasetError, match=r"20 attempts in a row failed, up to seed 24"):
        list(queue)


def test_successes_in_between_reset_the_count_of_failures():
    runner = Runner(failing=set(range(1000)) - {MAX_FAILURES_IN_A_ROW - 1, 2 * MAX_FAILURES_IN_A_ROW - 1})
    assert sum(success for _, success in AttemptQueue(runner, {}, 0, 2, ahead=1)) == 2
