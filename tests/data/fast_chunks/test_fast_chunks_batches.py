"""Whole batches of a DataLoader, set up as lerobot-train does, compared with LeRobot's own."""

from itertools import islice

import pytest
import torch
from accelerate import Accelerator
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.sampler import EpisodeAwareSampler
from lerobot.utils.collate import lerobot_collate_fn
from lerobot_sets import assert_same, seconds
from tiers import full_tier
from torch.utils.data import DataLoader, Subset

from lerobot_act_chunking.data.fast_chunks.batch import GatheredBatch
from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset

CHUNK = {"action": seconds(range(6)), "observation.state": seconds((-1, 0))}


def loader(dataset: LeRobotDataset, **options) -> DataLoader:
    sampler = EpisodeAwareSampler(
        dataset.meta.episodes["dataset_from_index"],
        dataset.meta.episodes["dataset_to_index"],
        episode_indices_to_use=dataset.episodes,
        drop_n_last_frames=1,
        shuffle=True,
        seed=3,
        absolute_to_relative_idx=dataset.absolute_to_relative_idx,
    )
    return DataLoader(dataset, batch_size=5, sampler=sampler, **options)


@pytest.fixture
def counted(monkeypatch):
    """The batch sizes that were asked for at once."""
    sizes, original = [], FastChunkDataset.__getitems__
    monkeypatch.setattr(
        FastChunkDataset,
        "__getitems__",
        lambda self, indices: (sizes.append(len(indices)), original(self, indices))[1],
    )
    return sizes


@pytest.mark.parametrize("episodes", [None, [3, 0, 2]], ids=str)
def test_batches(states, open_both, counted, episodes):
    fast, stock = open_both(states, delta_timestamps=CHUNK, episodes=episodes)
    assert_same(list(loader(fast)), list(loader(stock)))
    assert set(counted[:-1]) == {5}


def test_batches_are_not_taken_apart(states, open_both, monkeypatch):
    fast, _ = open_both(states, delta_timestamps=CHUNK)
    handed_out = []
    original = GatheredBatch.__getitem__
    monkeypatch.setattr(
        GatheredBatch, "__getitem__", lambda self, i: (handed_out.append(i), original(self, i))[1]
    )
    batches = list(loader(fast))
    assert handed_out == [0] * len(batches)


def test_batches_with_texts_and_lerobots_collation(numbers, open_both):
    fast, stock = open_both(numbers, delta_timestamps=CHUNK)
    options = {"collate_fn": lerobot_collate_fn}
    assert_same(list(loader(fast, **options)), list(loader(stock, **options)))


def test_batches_with_videos(videos, open_both):
    fast, stock = open_both(videos, delta_timestamps=CHUNK, return_uint8=True)
    assert_same(list(loader(fast)), list(loader(stock)))


def test_a_subset_is_gathered_at_once(states, open_both, counted):
    fast, stock = open_both(states, delta_timestamps=CHUNK)
    chosen = [12, 3, 4, 16, 0, 9]
    ours, theirs = (list(DataLoader(Subset(dataset, chosen), batch_size=4)) for dataset in (fast, stock))
    assert_same(ours, theirs)
    assert counted == [4, 2]


def test_batches_through_accelerate(states, open_both, counted):
    fast, stock = open_both(states, delta_timestamps=CHUNK)
    accelerator = Accelerator(cpu=True)
    ours, theirs = (list(accelerator.prepare(loader(dataset))) for dataset in (fast, stock))
    assert_same(ours, theirs)
    assert set(counted[:-1]) == {5}


# Python warns of every fork of a process with threads; LeRobot's users may choose fork.
@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
def test_batches_of_forked_workers(states, open_both):
    fast, stock = open_both(states, delta_timestamps=CHUNK)
    ours = list(loader(fast, num_workers=2, multiprocessing_context="fork"))
    assert_same(ours, list(loader(stock)))


@full_tier
def test_batches_of_spawned_workers(states, open_both):
    fast, stock = open_both(states, delta_timestamps=CHUNK)
    ours = loader(fast, num_workers=2, multiprocessing_context="spawn", persistent_workers=True)
    for _ in range(2):
        ours.sampler.set_epoch(0)
        assert_same(list(ours), list(loader(stock)))


def test_batches_are_independent_of_the_dataset(states, open_both):
    fast, stock = open_both(states, delta_timestamps=CHUNK)
    for batch in islice(loader(fast), 2):
        batch["action"].zero_()
    assert torch.equal(fast[0]["action"], stock[0]["action"])
