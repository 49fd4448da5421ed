import json

import numpy as np
import pytest

from lerobot_act_chunking.data.fast_chunks.frames.store import (
    DESCRIPTION,
    FRAMES,
    SUMS,
    FrameStore,
    checksum,
    frame_shape,
)

SHAPE, N, CONTENT = (3, 4, 5), 7, {"dataset": "tests/fast"}


@pytest.fixture
def store(tmp_path):
    store = FrameStore(tmp_path / "frames", SHAPE, N)
    store.prepare(CONTENT)
    return store


def pixels(seed=0):
    return np.random.default_rng(seed).integers(0, 256, SHAPE, np.uint8)


def test_what_is_written_is_read_by_all_and_nothing_else_is_there(store):
    other = FrameStore(store.folder, SHAPE, N)
    assert other.read(3) is None
    store.write(3, pixels())
    for each in (store, other):
        assert np.array_equal(each.read(3), pixels())
        assert each.read(2) is None
        assert each.missing(np.array([1, 3, 6])).tolist() == [1, 6]


def test_preparing_again_keeps_the_frames(store):
    store.write(0, pixels())
    FrameStore(store.folder, SHAPE, N).prepare(CONTENT)
    assert np.array_equal(FrameStore(store.folder, SHAPE, N).read(0), pixels())


def damage(store, how):
    if how == "content":
        return {"dataset": "tests/other"}
    if how == "description":
        (store.folder / DESCRIPTION).write_text("{")
    elif how == "absent":
        (store.folder / SUMS).unlink()
    else:
        with (store.folder / FRAMES).open("r+b") as file:
            file.truncate(10)
    return CONTENT


@pytest.mark.parametrize("how", ["content", "description", "absent", "truncated"])
def test_a_broken_store_is_made_anew(store, how):
    store.write(0, pixels())
    content = damage(store, how)
    again = FrameStore(store.folder, SHAPE, N)
    again.prepare(content)
    assert again.read(0) is None
    assert json.loads((store.folder / DESCRIPTION).read_bytes()) == content
    again.write(0, pixels())
    assert np.array_equal(again.read(0), pixels())


def test_a_frame_that_was_half_written_is_not_there(store):
    store.write(0, pixels())
    with (store.folder / FRAMES).open("r+b") as file:
        file.seek(20)
        file.write(bytes(10))
    assert FrameStore(store.folder, SHAPE, N).read(0) is None


def test_a_deleted_store_is_an_error_of_the_disk(store):
    (store.folder / FRAMES).unlink()
    with pytest.raises(OSError, match=FRAMES):
        store.write(0, pixels())


def test_holes_take_no_room(tmp_path):
    store = FrameStore(tmp_path / "frames", (3, 480, 640), 100_000)
    store.prepare(CONTENT)
    state = (store.folder / FRAMES).stat()
    assert state.st_size > 9e10
    assert state.st_blocks * 512 < 1e6


def test_no_checksum_is_that_of_an_absent_frame():
    assert checksum(np.zeros(SHAPE, np.uint8)) > 0
    assert frame_shape((48, 64, 3), None) == (3, 48, 64)
    assert frame_shape((48, 64, 3), (24, 32)) == (3, 24, 32)
