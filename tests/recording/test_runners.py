import os
import signal
import time

import pytest
from fake_source import FakeSource

from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.recording.runners import InlineRunner, WorkerPool
from lerobot_act_chunking.recording.staging import EpisodeStore


def play(folder, workers, seeds, source=None):
    """Stored actions of some attempts, played here without workers."""
    store = EpisodeStore(folder)
    source = source or FakeSource(failing=(3,))
    with WorkerPool(source, store, workers) if workers else InlineRunner(source, store) as runner:
        for seed in seeds:
            runner.submit(seed)
        outcomes = {seed: runner.succeeded(seed) for seed in seeds}
    assert store.outcomes() == outcomes
    return {seed: store.load(seed).arrays["action"].tobytes() for seed in seeds if outcomes[seed]}


def test_workers_and_this_process_store_the_same_episodes(tmp_path):
    folders = [tmp_path / "here", tmp_path / "there"]
    for folder in folders:
        folder.mkdir()
    here, there = (play(folder, workers, range(5)) for folder, workers in zip(folders, (0, 2), strict=True))
    assert here == there
    assert here.keys() == {0, 1, 2, 4}


@pytest.mark.parametrize("workers", [0, 1])
def test_an_error_of_the_source_is_raised_here(tmp_path, workers):
    with pytest.raises(RuntimeError, match="seed 1 is cursed"):
        play(tmp_path, workers, [1], FakeSource(raising=(1,)))


def test_an_episode_that_is_not_finite_is_not_stored(tmp_path):
    with pytest.raises(DatasetError, match="action of seed 6 is nan at frame 4, entry dy"):
        play(tmp_path, 0, [6], FakeSource(not_finite=(6,)))
    assert EpisodeStore(tmp_path).outcomes() == {}


def test_a_failed_attempt_may_hold_anything(tmp_path):
    assert play(tmp_path, 0, [6], FakeSource(not_finite=(6,), failing=(6,))) == {}


def test_a_dead_worker_is_an_error_and_finished_episodes_stay(tmp_path):
    store = EpisodeStore(tmp_path)
    with WorkerPool(FakeSource(deadly=(2,)), store, 1) as runner:
        for seed in range(2):
            runner.submit(seed)
        assert [runner.succeeded(seed) for seed in range(2)] == [True, True]
        runner.submit(2)
        with pytest.raises(DatasetError, match=r"a recording worker died .* finished episodes are safe"):
            runner.succeeded(2)
    assert store.outcomes() == {0: True, 1: True}


def test_workers_leave_ctrl_c_to_the_recorder_and_end_with_it(tmp_path):
    with WorkerPool(FakeSource(), EpisodeStore(tmp_path), 1) as runner:
        runner.submit(0)
        assert runner.succeeded(0)
        processes = runner._workers.processes
        os.kill(processes[0].pid, signal.SIGINT)
        time.sleep(0.1)
        for seed in (1, 2):
            runner.submit(seed)
        assert runner.succeeded(1)
        assert runner.succeeded(2)
    assert not processes[0].is_alive()
