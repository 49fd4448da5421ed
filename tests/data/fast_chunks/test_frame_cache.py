"""Frames out of the cache are LeRobot's, decoded once; whatever happens to the cache, items stay right."""

import errno
import logging
import os
import pickle
import re
import shutil
import subprocess
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import torch
from filelock import FileLock
from lerobot.datasets import dataset_reader
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot_sets import LENGTHS, REPO_ID, assert_same, batch, seconds
from torch.utils.data import DataLoader, default_collate
from torchvision.transforms import v2

from lerobot_act_chunking.data.actions import read_demonstrations
from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset
from lerobot_act_chunking.data.fast_chunks.frames import cache, filling
from lerobot_act_chunking.data.fast_chunks.frames.filling import fill, fill_in_background
from lerobot_act_chunking.data.fast_chunks.frames.store import FrameStore
from lerobot_act_chunking.data.fast_chunks.image_switch import ImageSwitch
from lerobot_act_chunking.data.fast_chunks.reading import Reading, with_reading
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.image_view import ImageView, resize

N = sum(LENGTHS)
CAMERAS = ("observation.images.top", "observation.images.side")
SIZE = (30, 40)
WINDOWS = {
    "observation.images.top": seconds((-1, 0)),
    "observation.images.side": [0.0],
    "action": seconds((0, 1)),
}


@pytest.fixture(autouse=True)
def folder(monkeypatch, tmp_path):
    monkeypatch.setenv(cache.FOLDER, str(tmp_path / "cache"))
    monkeypatch.setattr(cache, "LEFT_FREE", 0)
    return tmp_path / "cache"


@pytest.fixture
def decodes(monkeypatch):
    """How many frames were decoded by calls of LeRobot's decoder in this process, call by call."""
    counted = []
    original = dataset_reader.decode_video_frames

    def count(path, timestamps, *args, **kwargs):
        counted.append(len(timestamps))
        return original(path, timestamps, *args, **kwargs)

    monkeypatch.setattr(dataset_reader, "decode_video_frames", count)
    return counted


def reading(timestamps=None, columns=(*CAMERAS, "observation.state", "action"), size=None, switch=None):
    return Reading(timestamps or {"action": [0.0]}, frozenset(columns), lambda _: None, switch, size)


def fast(root, timestamps=None, **options):
    options = {"video_backend": "pyav", "return_uint8": True} | options
    return FastChunkDataset(REPO_ID, root, delta_timestamps=timestamps, **options)


def lerobots(root, timestamps=None, **options):
    options = {"video_backend": "pyav", "return_uint8": True} | options
    return LeRobotDataset(REPO_ID, root, delta_timestamps=timestamps, **options)


@pytest.mark.parametrize(
    ("timestamps", "transforms"),
    [(None, None), (WINDOWS, v2.ColorJitter(0.5)), pytest.param(WINDOWS, None, marks=pytest.mark.slow)],
    ids=["frames", "transformed windows", "windows"],
)
def test_items_are_lerobots_cold_and_warm(videos, timestamps, transforms):
    dataset = fast(videos, timestamps, image_transforms=transforms)
    stock = lerobots(videos, timestamps, image_transforms=transforms)
    torch.manual_seed(0)
    theirs = [stock[i] for i in range(N)]
    for _ in range(2):
        torch.manual_seed(0)
        assert_same(batch(dataset, range(N)), theirs)
    assert dataset.chunks is not None
    assert dataset.chunks.whole is (transforms is None)


def test_a_batch_is_collated_as_its_items_are(videos):
    dataset = fast(videos, WINDOWS)
    assert_same(default_collate(dataset.__getitems__([3, 1])), default_collate([dataset[3], dataset[1]]))


def test_every_frame_is_decoded_once(videos, decodes):
    dataset = fast(videos, WINDOWS)
    assert decodes == []
    batch(dataset, range(N))
    in_two_places = len(LENGTHS)  # of its window: an episode's first frame stands in for the one before it
    assert sum(decodes) == 2 * N + in_two_places
    decodes.clear()
    batch(dataset, range(N))
    batch(fast(videos, WINDOWS), range(N))  # nor by who comes later, nor by a worker that was spawned
    assert_same(batch(pickle.loads(pickle.dumps(dataset)), [4]), [dict(dataset[4])])
    assert decodes == []


def test_some_episodes_share_the_frames_of_all(videos, decodes):
    batch(fast(videos), range(N))
    decodes.clear()
    some, stock = fast(videos, WINDOWS, episodes=[1, 2]), lerobots(videos, WINDOWS, episodes=[1, 2])
    ours = batch(some, range(len(some)))
    assert decodes == []
    assert_same(ours, [stock[i] for i in range(len(stock))])


def test_frames_are_resized_once(videos, decodes):
    dataset, stock = fast(videos, reading(size=SIZE)), lerobots(videos, {"action": [0.0]})
    for _ in range(2):
        for i in (0, 5, N - 1):
            for key in CAMERAS:
                assert torch.equal(dataset[i][key], resize(stock[i][key], SIZE))
    decodes.clear()
    _ = dataset[5]
    assert decodes == []


def test_without_the_cache_frames_are_resized_just_as_well(videos, monkeypatch, folder):
    cached = fast(videos, reading(size=SIZE))[3]
    monkeypatch.setenv(cache.FOLDER, "0")
    shutil.rmtree(folder)
    assert_same(fast(videos, reading(size=SIZE))[3], cached)
    assert not folder.exists()


def test_who_reads_numbers_or_asks_for_floats_makes_no_cache(videos, folder):
    assert CAMERAS[0] not in fast(videos, reading(columns=("observation.state", "action")))[0]
    assert fast(videos, return_uint8=False)[0][CAMERAS[0]].dtype is torch.float32
    assert not folder.exists()


def test_numbers_alone_decode_nothing(videos, decodes):
    """Tokenizers, whose training reads actions, and the tokenizer's phase, which turns images off."""
    assert len(read_demonstrations(videos).episode) == N
    switch = ImageSwitch()
    dataset = fast(videos, reading(switch=switch))
    switch.want_images_in(1000)
    assert CAMERAS[0] not in batch(dataset, range(N))[0]
    fast(videos, reading(columns=("action",)))[2]
    assert decodes == []


def test_other_videos_have_other_frames(videos, tmp_path, decodes):
    copied = shutil.copytree(videos, tmp_path / "copied")
    batch(fast(copied), range(N))
    for file in (copied / "videos").rglob("*.mp4"):
        os.utime(file, ns=(1, 1))
    decodes.clear()
    batch(fast(copied), range(N))
    assert sum(decodes) == 2 * N


def test_a_full_disk_is_said_once_and_items_stay_right(videos, monkeypatch, caplog):
    dataset, stock = fast(videos), lerobots(videos)
    whole = FrameStore.write

    def write(self, frame, pixels):
        if frame > 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        whole(self, frame, pixels)

    monkeypatch.setattr(FrameStore, "write", write)
    for _ in range(2):
        assert_same(batch(dataset, range(N)), [stock[i] for i in range(N)])
    warnings = [record.message for record in caplog.records if record.levelno == logging.WARNING]
    assert len(warnings) == 1
    assert "No space left on device" in warnings[0]


def test_a_cache_that_is_deleted_meanwhile_is_done_without(videos, folder):
    dataset, stock = fast(videos), lerobots(videos)
    _ = dataset[0]
    shutil.rmtree(folder)
    assert_same(batch(dataset, range(N)), [stock[i] for i in range(N)])


def test_a_folder_that_cannot_be_written_is_done_without(videos, folder, caplog):
    folder.write_text("a file")
    assert_same(fast(videos)[1], lerobots(videos)[1])
    assert "without a cache" in caplog.text


@pytest.mark.parametrize(
    ("limit", "left_free", "message"),
    [
        ("0.0001", 0, "more than ACT_CHUNKING_FRAME_CACHE_GB=0.0001.*resize_shape"),
        ("9", 10**18, "names another folder"),
    ],
)
def test_what_does_not_fit_is_not_cached(videos, monkeypatch, caplog, folder, limit, left_free, message):
    monkeypatch.setenv(cache.LIMIT, limit)
    monkeypatch.setattr(cache, "LEFT_FREE", left_free)
    assert_same(fast(videos)[1], lerobots(videos)[1])
    assert list(folder.glob("*/")) == []
    (record,) = (record for record in caplog.records if "without a cache" in record.message)
    assert re.search(message, record.message)


def test_a_limit_that_is_no_number_is_refused(videos, monkeypatch):
    monkeypatch.setenv(cache.LIMIT, "much")
    with pytest.raises(ConfigurationError, match="ACT_CHUNKING_FRAME_CACHE_GB=much must be a number"):
        fast(videos)


def test_what_was_not_used_for_longest_goes_first(videos, monkeypatch, folder):
    sizes = [(64, 64), (64, 80), (48, 64)]
    for age, size in enumerate(sizes):
        batch(fast(videos, reading(size=size)), range(N))
        for description in folder.glob(f"*.{size[0]}x{size[1]}.*/{cache.DESCRIPTION}"):
            os.utime(description, (1000 * age, 1000 * age))
    _ = fast(videos, reading(size=sizes[0]))  # used again
    held = sum(map(cache._bytes_on_disk, folder.glob("*/")))
    monkeypatch.setenv(cache.LIMIT, str((held + 1000) / 1e9))
    _ = fast(videos, reading(size=(32, 32)))
    left = Counter(path.name.split(".")[-2] for path in folder.glob("*/"))
    assert left == {"64x64": 2, "64x80": 1, "48x64": 2, "32x32": 2}


def test_a_policy_tells_its_size(videos):
    class Config:
        image_view = ImageView(resize_shape=SIZE)

        def check_dataset(self, *_):
            pass

        def keys_read(self, features):
            return frozenset(features)

    resolve = with_reading(lambda *_: {"action": [0.0]})
    assert resolve(Config(), fast(videos).meta).resize_shape == SIZE


def options(root, dataset):
    settings = {"repo_id": REPO_ID, "root": str(root), "video_backend": "pyav", "tolerance_s": 1e-4}
    return {"dataset": settings, "cameras": list(dataset._frames.stores), "size": SIZE}


def test_the_background_decodes_what_is_missing(videos, decodes, caplog):
    dataset = fast(videos, reading(size=SIZE))
    _ = dataset[6]
    decodes.clear()
    fill(options(videos, dataset), os.getpid())
    assert decodes == []  # this process is not its child
    store = dataset._frames.stores[CAMERAS[0]]
    with FileLock(store.folder / "filling.lock"):  # somebody else does it
        fill(options(videos, dataset), os.getppid())
    assert decodes == []
    with caplog.at_level(logging.INFO, logger=filling.__name__):
        fill(options(videos, dataset), os.getppid())
    assert sum(decodes) == 2 * (N - 1)
    assert max(decodes) > 1  # neighbouring frames at once
    assert "complete" in caplog.text
    decodes.clear()
    stock = lerobots(videos, {"action": [0.0]})
    assert torch.equal(dataset[9][CAMERAS[1]], resize(stock[9][CAMERAS[1]], SIZE))
    assert dataset._frames.missing(np.arange(N))[CAMERAS[0]].size == 0
    assert len(decodes) == 2  # LeRobot's


def test_the_background_starts_only_where_it_is_worth_it(videos, monkeypatch):
    started = []

    class Process(subprocess.Popen):
        def __init__(self, arguments):
            started.append(arguments)

        def terminate(self):
            started.append("terminated")

        def wait(self):
            started.append("waited")

    monkeypatch.setattr(filling.subprocess, "Popen", Process)
    monkeypatch.setattr(filling.atexit, "register", lambda end, process: end(process))
    dataset = fast(videos)
    assert started == []  # so few frames are soon there
    monkeypatch.setattr(filling, "FEW", 3)
    fill_in_background(dataset, dataset._frames)
    assert started[0][1:3] == ["-m", filling.__name__]
    assert started[1:] == ["terminated", "waited"]
    batch(dataset, range(N))
    started.clear()
    fill_in_background(dataset, dataset._frames)
    assert started == []


@pytest.mark.slow
def test_data_workers_share_the_frames(videos, decodes):
    dataset, stock = fast(videos, WINDOWS), lerobots(videos, WINDOWS)
    in_workers = list(DataLoader(dataset, 4, num_workers=2))
    decodes.clear()
    assert_same(batch(dataset, range(N)), [stock[i] for i in range(N)])
    assert len(decodes) == 2 * N  # LeRobot's: what workers have stored is here, too
    for ours, theirs in zip(in_workers, DataLoader(stock, 4), strict=True):
        assert_same(ours, theirs)


@pytest.mark.slow
def test_a_process_of_its_own_fills_the_cache(videos, monkeypatch):
    monkeypatch.setattr(filling, "FEW", 3)
    processes = []
    monkeypatch.setattr(filling.atexit, "register", lambda end, process: processes.append(process))
    dataset = fast(videos, reading(size=SIZE))
    assert processes[0].wait(timeout=120) == 0
    assert all(missing.size == 0 for missing in dataset._frames.missing(np.arange(N)).values())


RECORDINGS = Path(os.environ.get("ACT_CHUNKING_RECORDINGS", "../shared/data"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cloth", "g1"])
def test_real_recordings(name, monkeypatch):
    root = RECORDINGS / name
    if not root.is_dir():
        pytest.skip(f"there is no {root}")
    monkeypatch.setattr(filling, "FEW", 10**9)
    dataset, stock = fast(root), lerobots(root)
    rows = np.random.default_rng(0).integers(len(stock), size=12).tolist()
    theirs = [stock[i] for i in rows]
    for _ in range(2):
        assert_same(batch(dataset, rows), theirs)
