"""Property: an item of the fast reader is LeRobot's item, or the same kind of error, whatever the dataset."""

import functools
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from lerobot.datasets.dataset_tools import delete_episodes, merge_datasets, split_dataset
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot_sets import FPS, REPO_ID, assert_same, camera, draw, record, seconds
from tiers import draws
from torchvision.transforms import v2

from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset

N_DATASETS = draws(gate=2, full=100)
N_OPENINGS = 8  # of each dataset, of about 15 frames: 10 000 items in all in the full tier
DTYPES = ("float32", "float64", "float16", "int64", "int32", "uint8", "bool", "string")
SHAPES = ((1,), (3,), (6,), (2, 5), (1, 4), (2, 3, 4))
KEYS = (
    "observation.state",
    "observation.force",
    "observation.environment_state",
    "next.reward",
    "action.note",
)


def drawn_features(rng: np.random.Generator) -> dict[str, Any]:
    """An action, some other columns of any type, and sometimes a camera."""
    features = {"action": {"dtype": "float32", "shape": SHAPES[rng.integers(3)], "names": None}}
    for key in rng.permutation(KEYS)[: rng.integers(1, 5)]:
        dtype = str(rng.choice(DTYPES))
        shape = (1,) if dtype == "string" else SHAPES[rng.integers(len(SHAPES) if rng.random() < 0.5 else 3)]
        features[str(key)] = {"dtype": dtype, "shape": shape, "names": None}
    if rng.random() < 0.3:
        features["observation.images.top"] = camera("image", 6, 10)
    return features


def sometimes_nan(feature: dict[str, Any], rng: np.random.Generator) -> Any:
    value = draw(feature, rng)
    if feature["dtype"].startswith("float") and rng.random() < 0.1:
        value.flat[rng.integers(value.size)] = rng.choice([np.nan, np.inf])
    return value


def edited(root: Path, rng: np.random.Generator) -> Path:
    """The dataset as it was recorded, or as one of LeRobot's tools leaves it."""
    edit, stock = rng.integers(4), LeRobotDataset(REPO_ID, root)
    if edit == 0 or any(
        len(feature["shape"]) > 1 and feature["dtype"] != "image" for feature in stock.features.values()
    ):
        return root  # the tools of 0.6.1 fail at arrays of several dimensions
    if edit == 1:
        gone = rng.permutation(stock.num_episodes)[:1].tolist()
        return delete_episodes(stock, gone, root.parent / "fewer", REPO_ID).root
    chosen = sorted(rng.permutation(stock.num_episodes)[:2].tolist())
    if edit == 2:
        return split_dataset(stock, {"part": chosen}, root.parent / "split")["part"].root
    return merge_datasets([stock, stock], REPO_ID, root.parent / "merged").root


def drawn_options(features: dict[str, Any], n_episodes: int, rng: np.random.Generator) -> dict[str, Any]:
    """How the dataset is opened."""
    options: dict[str, Any] = {"video_backend": "pyav"}
    if rng.random() < 0.8:
        keys = [*features, "timestamp"]
        chosen = rng.permutation(keys)[: rng.integers(0, len(keys) + 1)]
        if rng.random() < 0.5:  # else a column of text mostly decides what becomes of the item
            chosen = [key for key in chosen if features.get(key, {}).get("dtype") != "string"]
        options["delta_timestamps"] = {str(key): seconds(_offsets(rng)) for key in chosen}
        if rng.random() < 0.05:
            options["delta_timestamps"]["observation.absent"] = seconds((0, 1))
        if rng.random() < 0.05:
            options["delta_timestamps"]["action"] = [0.0, 0.3 / FPS]
    if rng.random() < 0.4:
        options["episodes"] = rng.permutation(n_episodes)[: rng.integers(1, n_episodes + 1)].tolist()
    if rng.random() < 0.3:
        options["image_transforms"] = v2.ColorJitter(brightness=0.5)
    return options


def _offsets(rng: np.random.Generator) -> list[int]:
    kind = rng.integers(5)
    if kind == 0:
        return [] if rng.random() < 0.5 else [0]
    if kind == 1:
        return list(range(int(rng.integers(1, 9))))
    return rng.integers(-20, 20, rng.integers(1, 5)).tolist()


def answer(ask: Any) -> Any:
    """What is returned; of an error its kind."""
    try:
        torch.manual_seed(0)
        return ask()
    except Exception as error:
        return type(error)


def compare(root: Path, options: dict[str, Any], rng: np.random.Generator) -> int:
    """Every item, alone and in batches; returns how many there were."""
    fast, stock = (answer(functools.partial(cls, REPO_ID, root, **options)) for cls in KINDS)
    if isinstance(stock, type):
        assert fast is stock
        return 0
    size = len(stock)
    assert len(fast) == size
    for row in [*range(size), -1, size, -size - 1]:
        assert_same(answer(lambda row=row: fast[row]), answer(lambda row=row: stock[row]))
    rows = rng.integers(size, size=5).tolist()
    theirs = answer(lambda: [stock[row] for row in rows])
    ours = answer(lambda: [dict(item) for item in fast.__getitems__(rows)])
    assert_same(ours, theirs)
    return size


KINDS = (FastChunkDataset, LeRobotDataset)


# LeRobot's statistics of values that are not finite.
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("seed", range(N_DATASETS))
def test_items_are_lerobots_or_its_errors(tmp_path, seed):
    rng = np.random.default_rng(seed)
    features = drawn_features(rng)
    lengths = rng.integers(2, 8, 3).tolist()
    options = {"use_videos": False, "value": sometimes_nan, "seed": seed}
    if rng.random() < 0.5:
        options["data_files_size_in_mb"] = 0.001
    root = edited(record(tmp_path / "set", features, lengths, **options), rng)
    n_episodes = LeRobotDataset(REPO_ID, root).num_episodes
    n_items = sum(compare(root, drawn_options(features, n_episodes, rng), rng) for _ in range(N_OPENINGS))
    assert n_items > 0


def test_a_missing_value_that_nobody_asked_for_is_lerobots_error(tmp_path):
    vector = {"dtype": "float32", "names": None}
    features = {"action": {**vector, "shape": (3,)}, "observation.force": {**vector, "shape": (1,)}}
    root = record(tmp_path / "set", features, (6,), use_videos=False)
    (path,) = (root / "data").rglob("*.parquet")
    table, key = pq.read_table(path), "observation.force"
    values = [None if row == 3 else value for row, value in enumerate(table[key].to_pylist())]
    column = pa.array(values, table.schema.field(key).type)
    pq.write_table(table.set_column(table.column_names.index(key), table.schema.field(key), column), path)
    options = {"delta_timestamps": {"action": seconds((0, 1, 2))}}
    assert compare(root, options, np.random.default_rng(0)) == 6
    stock = LeRobotDataset(REPO_ID, root, **options)
    assert answer(lambda: stock[2]) is RuntimeError


def test_empty_offsets_and_offsets_of_text_are_answered_as_by_lerobot(numbers, open_both):
    empty = open_both(numbers, delta_timestamps={"action": []})
    assert_same(*(answer(lambda each=each: each[3]) for each in empty))
    text = open_both(numbers, delta_timestamps={"label": seconds((0, 1))})
    assert [answer(lambda each=each: each[3]) for each in text] == [TypeError, TypeError]


def test_what_fails_in_the_reader_is_left_to_lerobot(states, open_both, monkeypatch, caplog):
    fast, stock = open_both(states, delta_timestamps={"action": seconds(range(3))})
    monkeypatch.setattr(type(fast.chunks), "_gather", lambda *_: 1 / 0)
    assert_same(fast[4], stock[4])
    said = [record.message for record in caplog.records if record.name.startswith("lerobot_act_chunking")]
    assert said == [f"fast chunks are off for {REPO_ID}: ZeroDivisionError('division by zero')"]
    assert fast.chunks is None
