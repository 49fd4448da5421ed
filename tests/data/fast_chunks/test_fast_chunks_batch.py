"""A batch gathered whole, beside torch's own collation of a list of dictionaries."""

import pytest
import torch
from lerobot_sets import assert_same
from torch.utils.data import default_collate

from lerobot_act_chunking.data.fast_chunks.batch import GatheredBatch


@pytest.fixture
def batch() -> GatheredBatch:
    return GatheredBatch(
        {
            "action": torch.arange(30.0).reshape(3, 5, 2),
            "index": torch.tensor([7, 8, 9]),
            "text": ["a", "b", "c"],
            "event": [{"n": 1}, {"n": 2}, {"n": 3}],
        }
    )


def plain(batch: GatheredBatch) -> list[dict]:
    return [dict(item) for item in batch]


def test_it_is_a_sequence_of_dictionaries(batch):
    assert len(batch) == 3
    assert_same(plain(batch)[1], {**batch[1]})
    assert [item["index"] for item in batch] == [7, 8, 9]
    assert batch[-1] is batch[2]
    assert [item["text"] for item in batch[1:]] == ["b", "c"]
    assert isinstance(batch[0], dict)
    with pytest.raises(IndexError):
        batch[3]


def test_it_is_collated_without_being_taken_apart(batch):
    collated = default_collate(batch)
    assert collated["action"] is batch.columns["action"]
    assert_same(collated, default_collate(plain(batch)))


def test_a_list_of_its_items_is_collated_alike(batch):
    assert_same(default_collate([batch[2], batch[0]]), default_collate([plain(batch)[2], plain(batch)[0]]))


@pytest.mark.parametrize("position", [0, 1])
@pytest.mark.parametrize(
    "change",
    [
        lambda item: item.update(action=torch.full((5, 2), -1.0)),
        lambda item: item["action"].fill_(-1.0),
        lambda item: item.__setitem__("text", "z"),
    ],
    ids=["replaced", "written into", "other text"],
)
def test_what_was_changed_in_an_item_is_collated(batch, position, change):
    change(batch[position])
    expected = default_collate(plain(batch))
    assert_same(default_collate(batch), expected)
    assert (expected["action"][position] == -1).all() or expected["text"][position] == "z"


def test_keys_added_to_or_taken_from_items_are_collated(batch):
    for item in batch:
        item["weight"] = 1.0
        del item["event"]
    assert list(default_collate(batch)) == ["action", "index", "text", "weight"]


def test_a_key_taken_from_the_first_item_only_is_left_out_as_in_torch(batch):
    del batch[0]["text"]
    assert list(default_collate(batch)) == ["action", "index", "event"]
