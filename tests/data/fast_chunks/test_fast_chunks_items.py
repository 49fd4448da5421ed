"""Every item, compared with LeRobot's own."""

import json
import logging
import pickle
from itertools import product
from pathlib import Path

import datasets
import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from lerobot.datasets.dataset_reader import DatasetReader
from lerobot.datasets.language import LANGUAGE_EVENTS, language_events_column_feature
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot_sets import REPO_ID, assert_same, batch, seconds
from tiers import some
from torchvision.transforms import v2

from lerobot_act_chunking.data.fast_chunks import columns
from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset


def assert_equal_items(fast: FastChunkDataset, stock: LeRobotDataset) -> None:
    """One by one and all at once, with equal random numbers for the image transforms."""
    assert fast.chunks is not None
    assert len(fast) == len(stock)
    indices = range(len(stock))
    torch.manual_seed(0)
    theirs = [stock[index] for index in indices]
    torch.manual_seed(0)
    assert_same([fast[index] for index in indices], theirs)
    torch.manual_seed(0)
    assert_same(batch(fast, indices), theirs)


OFFSETS = {
    "no chunks": None,
    "action chunk": {"action": range(10)},
    "all kinds": {
        "observation.state": (-2, -1, 0),
        "observation.precise": (0,),
        "observation.grid": (-1, 1),
        "observation.tactile": (0, 2),
        "observation.switches": (-3, 0),
        "next.reward": range(4),
        "next.done": (1,),
        "action": (-1, 0, 1, 2, 3),
    },
    "scattered": {"action": (4, -1, 0), "observation.state": (-20, 20)},
}


@pytest.mark.parametrize(
    ("offsets", "episodes"),
    some(8, product(OFFSETS.values(), [None, [2, 0], [3], [1, 2, 3]]), by=lambda case: id(case[0])),
    ids=str,
)
def test_numbers(numbers, open_both, offsets, episodes):
    stamps = None if offsets is None else {key: seconds(steps) for key, steps in offsets.items()}
    assert_equal_items(*open_both(numbers, delta_timestamps=stamps, episodes=episodes))


@pytest.mark.parametrize("episodes", [None, [0, 3]], ids=str)
def test_numbers_in_memory_mapped_pieces(numbers, open_both, episodes, monkeypatch):
    monkeypatch.setattr(columns, "JOIN_LIMIT_BYTES", 0)
    fast, stock = open_both(numbers, delta_timestamps={"action": seconds(range(-2, 6))}, episodes=episodes)
    action = fast.chunks.columns["action"]
    assert len(action.pieces) == len(episodes or range(4))
    assert not action.pieces[0].flags.writeable
    assert_equal_items(fast, stock)
    assert_same(fast[-2], stock[-2])


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"delta_timestamps": {"action": seconds(range(6))}},
        {"delta_timestamps": {"observation.images.side": seconds((-1, 0)), "action": seconds(range(6))}},
        {"delta_timestamps": {"observation.images.depth": seconds((0, 2))}, "depth_output_unit": "m"},
        {"image_transforms": v2.ColorJitter(brightness=0.5), "episodes": [1, 3]},
        {"depth_output_unit": "m"},
    ],
    ids=["plain", "action chunk", "image chunk", "depth chunk in metres", "random transforms", "metres"],
)
def test_images(images, open_both, options):
    assert_equal_items(*open_both(images, **options))


@pytest.mark.parametrize(
    "options",
    [
        {"delta_timestamps": {"action": seconds(range(6))}, "return_uint8": True},
        {"delta_timestamps": {"observation.images.side": seconds((-1, 0)), "action": seconds(range(3))}},
        {"delta_timestamps": {"observation.images.top": seconds((-1, 0))}, "episodes": [2]},
        {"image_transforms": v2.ColorJitter(brightness=0.5), "episodes": [0, 3]},
    ],
    ids=["action chunk, uint8", "video chunk", "video chunk of one episode", "random transforms"],
)
def test_videos(videos, open_both, options):
    assert_equal_items(*open_both(videos, **options))


def test_language_columns(numbers, open_both, tmp_path):
    root = tmp_path / "set"
    add_language(numbers, root)
    fast, stock = open_both(root, delta_timestamps={"action": seconds(range(3))})
    assert stock[1][LANGUAGE_EVENTS][0]["content"] == "look"
    assert_equal_items(fast, stock)


def add_language(source: Path, root: Path) -> None:
    """A copy of a dataset in which every second frame carries a sentence."""
    for path in source.rglob("*"):
        copy = root / path.relative_to(source)
        copy.mkdir(parents=True) if path.is_dir() else copy.write_bytes(path.read_bytes())
    event = {"role": "user", "content": "look", "style": "interjection", "camera": None, "tool_calls": None}
    feature = datasets.Features({LANGUAGE_EVENTS: language_events_column_feature()})
    for path in (root / "data").rglob("*.parquet"):
        frames = pq.read_table(path)
        rows = [[event] if index % 2 else [] for index in frames["index"].to_pylist()]
        events = datasets.Dataset.from_dict({LANGUAGE_EVENTS: rows}, features=feature).data.column(0)
        pq.write_table(frames.append_column(LANGUAGE_EVENTS, events).replace_schema_metadata(None), path)
    info = json.loads((root / "meta/info.json").read_text())
    info["features"][LANGUAGE_EVENTS] = {"dtype": "language", "shape": (1,), "names": None}
    (root / "meta/info.json").write_text(json.dumps(info))


def test_every_way_to_index(states, open_both):
    fast, stock = open_both(states)
    assert_same(fast[-1], stock[-1])
    assert_same(fast[-len(fast)], stock[0])
    assert_same(fast[np.int64(4)], stock[4])
    assert_same(fast[torch.tensor(4)], stock[4])
    assert_same(fast[3:9:2], stock[3:9:2])
    assert_same(batch(fast, [5, -1, 5]), [stock[5], stock[-1], stock[5]])
    assert_same(batch(fast, []), [])
    assert_same(list(fast), list(stock))


@pytest.mark.parametrize("index", [17, -18])
def test_an_index_beyond_the_end_is_refused_alike(states, open_both, index):
    fast, stock = open_both(states)
    with pytest.raises(IndexError) as theirs:
        stock[index]
    with pytest.raises(IndexError) as ours:
        fast[index]
    assert str(ours.value) == str(theirs.value)


def test_a_chunk_of_texts_is_refused_by_lerobot(numbers, open_both):
    for dataset in open_both(numbers, delta_timestamps={"label": seconds((0, 1))}):
        with pytest.raises((TypeError, KeyError), match=r"expected Tensor|label"):
            dataset[0]


def test_writing_into_an_item_changes_neither_the_dataset_nor_its_neighbours(states, open_both):
    fast, stock = open_both(states, delta_timestamps={"action": seconds(range(3))})
    first, second = batch(fast, [0, 1])
    for value in first.values():
        if isinstance(value, torch.Tensor):
            value.zero_()
    assert_same(second, stock[1])
    assert_same(fast[0], stock[0])


def test_keys_with_equal_offsets_have_their_own_padding(states, open_both):
    stamps = {"action": seconds(range(9)), "observation.state": seconds(range(9))}
    fast, stock = open_both(states, delta_timestamps=stamps)
    item = fast[0]
    item["action_is_pad"].fill_(True)
    assert_same(item["observation.state_is_pad"], stock[0]["observation.state_is_pad"])


def test_a_replaced_table_is_read_anew(states, open_both):
    fast, stock = open_both(states)
    for dataset in (fast, stock):
        dataset.reader.hf_dataset = dataset.hf_dataset.select([9, 3, 8])
    assert fast[0]["index"] == 9
    assert_same(batch(fast, [0, 1, 2]), [stock[row] for row in range(3)])


def test_replaced_offsets_are_used(states, open_both):
    fast, stock = open_both(states, delta_timestamps={"action": seconds(range(3))})
    for dataset in (fast, stock):
        dataset.reader.delta_indices = {"action": [0, -1]}
    assert_equal_items(fast, stock)


def test_the_default_float_type_is_followed(states, open_both):
    fast, stock = open_both(states)
    torch.set_default_dtype(torch.float64)
    try:
        assert fast.chunks is not None
        assert fast[2]["action"].dtype == torch.float64
        assert_same(fast[2], stock[2])
    finally:
        torch.set_default_dtype(torch.float32)


def test_a_transform_of_the_users_own_is_left_to_lerobot(states, open_both, caplog):
    fast, stock = open_both(states)
    for dataset in (fast, stock):
        dataset.hf_dataset.set_transform(lambda rows: {k: [torch.tensor(7 * v[0])] for k, v in rows.items()})
    with caplog.at_level(logging.WARNING):
        assert_same(fast[3], stock[3])
    assert fast.chunks is None
    assert f"fast chunks are off for {REPO_ID}: LeRobot has another 'observation.state'" in caplog.messages


def test_a_lerobot_with_more_in_its_items_is_left_to_itself(states, open_both, monkeypatch, caplog):
    get_item = DatasetReader.get_item
    monkeypatch.setattr(
        DatasetReader, "get_item", lambda self, idx: {**get_item(self, idx), "subtask": "grasp"}
    )
    with caplog.at_level(logging.WARNING):
        fast, stock = open_both(states)
    assert fast.chunks is None
    assert fast[5]["subtask"] == "grasp"
    assert_same(batch(fast, [5, 6]), [stock[5], stock[6]])
    assert caplog.messages == [f"fast chunks are off for {REPO_ID}: LeRobot has another 'subtask'"]


def test_values_that_are_not_finite_do_not_turn_it_off(open_both, states, monkeypatch):
    nan = np.full((17, 4), np.nan, np.float32)
    monkeypatch.setattr(
        "lerobot_act_chunking.data.fast_chunks.agreement._items",
        lambda *_: ({"action": torch.from_numpy(nan)}, {"action": torch.from_numpy(nan)}),
    )
    assert open_both(states)[0].chunks is not None


def test_a_dataset_being_written_is_lerobots(tmp_path):
    features = {"action": {"dtype": "float32", "shape": (4,), "names": None}}
    dataset = FastChunkDataset.create(REPO_ID, 10, features, root=tmp_path / "set", video_backend="pyav")
    assert dataset.chunks is None
    with pytest.raises(RuntimeError, match="being recorded"):
        dataset[0]
    for step in range(3):
        dataset.add_frame({"action": np.full(4, step, np.float32), "task": "lift"})
    dataset.save_episode()
    dataset.finalize()
    assert [int(item["action"][0]) for item in dataset] == [0, 1, 2]
    assert dataset.chunks is None


def test_pickling_leaves_the_arrays_behind(states, open_both):
    fast, stock = open_both(states, delta_timestamps={"action": seconds(range(3))})
    copied = pickle.loads(pickle.dumps(fast))
    assert copied._chunks is None
    assert_equal_items(copied, stock)


def test_arrays_are_there_before_data_workers_are_forked(states, open_both):
    assert open_both(states)[0]._chunks is not None
