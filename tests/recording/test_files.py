import errno
import os

import pytest

from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.recording.files import explain_full_disk, sync_tree, write_atomically


def test_a_failed_write_leaves_the_old_content_and_nothing_else(tmp_path):
    path = tmp_path / "file"
    path.write_text("old")

    def fail(file):
        file.write(b"half of the n")
        raise OSError(errno.EIO, "the disk fell off")

    with pytest.raises(OSError, match="fell off"):
        write_atomically(path, fail)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_content_is_on_the_disk_before_it_gets_its_name(tmp_path, monkeypatch):
    events = []
    real = os.fsync
    monkeypatch.setattr(os, "fsync", lambda handle: (events.append((tmp_path / "f").exists()), real(handle)))
    write_atomically(tmp_path / "f", lambda file: file.write(b"new"))
    assert events == [False, True]  # the file before it has its name, the folder after
    assert (tmp_path / "f").read_bytes() == b"new"


def test_a_tree_is_synced_whole(tmp_path, monkeypatch):
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "a" / "file").write_text("x")
    synced = []
    monkeypatch.setattr(os, "fsync", lambda handle: synced.append(os.fstat(handle).st_ino))
    sync_tree(tmp_path)
    everything = (tmp_path, tmp_path / "a", tmp_path / "a" / "b", tmp_path / "a" / "file")
    assert sorted(synced) == sorted(path.stat().st_ino for path in everything)


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.ENOSPC, "No space left on device"),
        OSError(errno.EDQUOT, "Disk quota exceeded"),
        RuntimeError("Encoder thread for eye failed: [Errno 28] No space left on device: 'x.mp4'"),
    ],
)
def test_a_full_disk_is_explained(tmp_path, error):
    message = f"the disk is full .*safe in {tmp_path}: free some space and run the same command again"
    with pytest.raises(DatasetError, match=message), explain_full_disk(tmp_path):
        raise error


def test_other_errors_pass_unchanged(tmp_path):
    with pytest.raises(PermissionError), explain_full_disk(tmp_path):
        raise PermissionError(errno.EACCES, "no")
