"""A full disk: a clear error, nothing lost, and the same command goes on when there is space."""

import errno
import os
import shutil
import subprocess

import pytest
from fake_source import FakeSource, files

from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.recording import Target, record_source
from lerobot_act_chunking.recording.staging import EpisodeStore, staging_folder

MESSAGE = "the disk is full .* every finished episode is safe in .*: free some space"


def record(root, camera=False):
    return record_source(FakeSource(camera=camera), Target(root, "me/fake", 3))


def refused(root, camera):
    """The error of a recording, None when it succeeds."""
    try:
        record(root, camera)
    except DatasetError as error:
        return str(error)
    return None


@pytest.fixture
def small_disk(tmp_path):
    """Mounts a file system of a few kilobytes; calling it again resizes it."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = []

    def mount(kilobytes):
        how = f"remount,size={kilobytes}k" if mounted else f"size={kilobytes}k"
        command = ["mount", "-t", "tmpfs", "-o", how, "tmpfs", str(folder)]
        if subprocess.run(command, capture_output=True, check=False).returncode:
            pytest.skip("mounting needs root")
        mounted.append(kilobytes)
        return folder

    if shutil.which("mount") is None:
        pytest.skip("there is no mount command")
    yield mount
    if mounted:
        # Lazily: LeRobot's encoder does not close a file that it could not write.
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


@pytest.mark.parametrize("camera", [False, True])
def test_a_disk_that_fills_up_at_any_moment(small_disk, tmp_path, camera):
    record(tmp_path / "undisturbed", camera)
    expected = files(tmp_path / "undisturbed")
    refusals = 0
    for kilobytes in range(16, 200, 12):
        root = small_disk(kilobytes) / "data"
        refusal = refused(root, camera)
        if refusal is None:
            break
        assert "the disk is full" in refusal
        refusals += 1
        assert not root.exists()
        assert not (staging_folder(root) / "dataset").exists()
    assert refusals > 3
    assert files(root) == expected


def test_a_disk_that_is_full_from_the_start_is_refused(small_disk):
    folder = small_disk(12)
    for i in range(3):
        (folder / f"junk{i}").write_bytes(b"x" * 4096)
    with pytest.raises(DatasetError, match="the disk is full"):
        record(folder / "data")


def test_no_space_while_staging(tmp_path, monkeypatch):
    real, calls = os.fsync, []

    def fsync(handle):
        calls.append(handle)
        if len(calls) == 5:  # the second episode's file
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(handle)

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(DatasetError, match=MESSAGE):
        record(tmp_path / "data")
    staged = staging_folder(tmp_path / "data") / "episodes"
    assert EpisodeStore(staged).outcomes() == {0: True}
    assert [path.name for path in staged.iterdir()] == ["seed-0000000000.npz"]
    assert record(tmp_path / "data").episodes == 3


def test_no_space_for_lerobots_writer(tmp_path, monkeypatch):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    def full(self):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(LeRobotDataset, "save_episode", full)
        with pytest.raises(DatasetError, match=MESSAGE):
            record(tmp_path / "data")
    assert record(tmp_path / "data").episodes == 3
