import pytest
from fake_source import FakeSource
from tiers import full_tier

from lerobot_act_chunking.errors import DatasetError, WorkerError
from lerobot_act_chunking.recording.runners import StoringRunner, open_attempts
from lerobot_act_chunking.recording.staging import EpisodeStore


def play(folder, workers, seeds, source=None):
    """Stored actions of some attempts; one worker is this process."""
    store = EpisodeStore(folder)
    source = source or FakeSource(failing=(3,))
    with open_attempts(source, workers) as executor:
        runner = StoringRunner(executor, store)
        for seed in seeds:
            runner.submit(seed)
        outcomes = {seed: runner.succeeded(seed) for seed in seeds}
    assert store.outcomes() == outcomes
    return {seed: store.load(seed).arrays["action"].tobytes() for seed in seeds if outcomes[seed]}


def test_workers_and_this_process_store_the_same_episodes(tmp_path):
    folders = [tmp_path / "here", tmp_path / "there"]
    for folder in folders:
        folder.mkdir()
    here, there = (play(folder, workers, range(5)) for folder, workers in zip(folders, (1, 2), strict=True))
    assert here == there
    assert here.keys() == {0, 1, 2, 4}


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_of_the_source_is_raised_here(tmp_path, workers):
    with pytest.raises(RuntimeError, match="seed 1 is cursed"):
        play(tmp_path, workers, [1], FakeSource(raising=(1,)))


def test_an_episode_that_is_not_finite_is_not_stored(tmp_path):
    with pytest.raises(DatasetError, match="action of seed 6 is nan at frame 4, entry dy"):
        play(tmp_path, 1, [6], FakeSource(not_finite=(6,)))
    assert EpisodeStore(tmp_path).outcomes() == {}


def test_a_failed_attempt_may_hold_anything(tmp_path):
    assert play(tmp_path, 1, [6], FakeSource(not_finite=(6,), failing=(6,))) == {}


@full_tier
def test_an_episode_that_kills_its_workers_is_an_error_and_others_stay(tmp_path):
    store = EpisodeStore(tmp_path)
    with open_attempts(FakeSource(deadly=(2,)), 2) as executor:
        runner = StoringRunner(executor, store)
        for seed in range(4):
            runner.submit(seed)
        assert [runner.succeeded(seed) for seed in (0, 1, 3)] == [True, True, True]
        with pytest.raises(WorkerError, match=r"3 workers died one after the other .* finished is kept"):
            runner.succeeded(2)
    assert store.outcomes() == {0: True, 1: True, 3: True}
