import errno
import os

import pytest

from lerobot_act_chunking.durable_files import fill_atomically, sync_folder, sync_tree, write_atomically


def test_a_failed_write_leaves_the_old_content_and_nothing_else(tmp_path):
    path = tmp_path / "file"
    path.write_text("old")

    def fail(file):
        file.write(b"half of the n")
        raise OSError(errno.EIO, "the disk fell off")

    with pytest.raises(OSError, match="fell off"):
        fill_atomically(path, fail)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_content_is_on_the_disk_before_it_gets_its_name(tmp_path, monkeypatch):
    events = []
    real = os.fsync
    monkeypatch.setattr(os, "fsync", lambda handle: (events.append((tmp_path / "f").exists()), real(handle)))
    write_atomically(tmp_path / "f", b"new")
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


def test_a_file_may_be_written_elsewhere_first(tmp_path, monkeypatch):
    places = []
    monkeypatch.setattr(
        os, "fsync", lambda handle: places.append([len(list(each.iterdir())) for each in (target, scratch)])
    )
    target, scratch = tmp_path / "target", tmp_path / "scratch"
    target.mkdir()
    write_atomically(target / "file", b"new", scratch)
    assert places == [[0, 1], [1, 0]]
    assert (target / "file").read_bytes() == b"new"


def test_sync_of_a_folder_forgives_only_file_systems_that_cannot(tmp_path, monkeypatch):
    def failing(code):
        def fsync(descriptor):
            raise OSError(code, os.strerror(code))

        return fsync

    monkeypatch.setattr(os, "fsync", failing(errno.EINVAL))
    sync_folder(tmp_path)
    monkeypatch.setattr(os, "fsync", failing(errno.EIO))
    with pytest.raises(OSError, match=os.strerror(errno.EIO)):
        sync_folder(tmp_path)


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "file.safetensors"
    write_atomically(path, b"the old one")
    in_place = []

    def crash(_):
        in_place.append(path.read_bytes())
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", crash)
    with pytest.raises(KeyboardInterrupt):
        write_atomically(path, b"the new one")
    assert in_place == [b"the old one"]
    assert path.read_bytes() == b"the old one"
    assert list(tmp_path.iterdir()) == [path]
