"""Kill -9 and Ctrl-C at any moment: a resumed recording is, byte for byte, that of an undisturbed run."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from fake_source import FakeSource, files
from killed_recordings import EPISODES, FAILING, MOMENTS

from lerobot_act_chunking.recording import Target, record_source
from lerobot_act_chunking.recording.staging import EpisodeStore, staging_folder

KILLED_TWICE = "three_staged+lerobot_wrote"
SCRIPT = Path(__file__).with_name("killed_recordings.py")


def record(root, camera=False, log=None, **options):
    source = FakeSource(failing=FAILING, camera=camera, log=log)
    return record_source(source, Target(root, "me/fake", EPISODES), **options)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """Files of the recording without and with a camera."""
    roots = {camera: tmp_path_factory.mktemp("undisturbed") / "data" for camera in (False, True)}
    for camera, root in roots.items():
        record(root, camera)
    return {camera: files(root) for camera, root in roots.items()}


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """Recordings killed at each of the moments, and one killed at two."""
    folder = tmp_path_factory.mktemp("killed")
    command = [sys.executable, SCRIPT, folder, *MOMENTS, KILLED_TWICE]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=250)
    assert done.stdout == ""
    return folder


def played(log):
    return [int(line) for line in log.read_text().split()] if log.exists() else []


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_killed_recording_resumes_to_the_very_dataset(killed, undisturbed, moment):
    root, camera = killed / moment / "data", MOMENTS[moment][2]
    staged = set(EpisodeStore(staging_folder(root) / "episodes").outcomes())
    if moment == "published":
        assert files(root) == undisturbed[camera]
    else:
        assert not root.exists()
    log = killed / moment / "resumed.log"
    result = record(root, camera, log)
    assert files(root) == undisturbed[camera]
    assert result.already_complete == (moment == "published")
    assert not staging_folder(root).exists()
    # Nothing lost, nothing doubled: what was safe is not played again.
    assert not staged & set(played(log))
    if moment != "published":
        assert sorted(staged | set(played(log))) == list(range(EPISODES + len(FAILING)))


def test_moments_cover_nothing_some_and_everything_staged(killed):
    counts = {moment: len(set(played(killed / moment / "log"))) for moment in MOMENTS}
    assert counts["staging_first_file"] == 1
    assert counts["lerobot_writes"] == 3
    assert counts["before_publication"] == 5


def test_a_recording_killed_twice_resumes(killed, undisturbed):
    root = killed / KILLED_TWICE / "data"
    assert not root.exists()
    record(root)
    assert files(root) == undisturbed[False]


def test_workers_of_a_killed_recorder_end(killed):
    pids = [int(pid) for pid in (killed / "with_workers" / "workers").read_text().split()]
    assert len(pids) == 2
    deadline = time.monotonic() + 20
    while any(Path(f"/proc/{pid}").exists() for pid in pids) and time.monotonic() < deadline:
        time.sleep(0.2)
    assert not [pid for pid in pids if Path(f"/proc/{pid}").exists()]


@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_then_the_same_command_gives_the_very_dataset(undisturbed, tmp_path, workers):
    root, log = tmp_path / "data", tmp_path / "log"

    def stop(progress):
        if progress.recorded == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record(root, workers=workers, log=log, progress=stop)
    assert not root.exists()
    assert not (staging_folder(root) / "dataset").exists()
    staged = EpisodeStore(staging_folder(root) / "episodes").outcomes()
    assert {0: True, 1: False, 2: True}.items() <= staged.items()
    log.unlink()
    record(root, log=log)
    assert files(root) == undisturbed[False]
    assert not set(staged) & set(played(log))


def test_more_or_fewer_episodes_may_be_asked_for_while_unfinished(undisturbed, tmp_path):
    def stop(progress):
        raise KeyboardInterrupt

    source = FakeSource(failing=FAILING)
    with pytest.raises(KeyboardInterrupt):
        record_source(source, Target(tmp_path / "data", "me/fake", 50), progress=stop)
    record(tmp_path / "data")
    assert files(tmp_path / "data") == undisturbed[False]


def test_a_staged_file_that_was_damaged_is_recorded_again(undisturbed, tmp_path):
    root = tmp_path / "data"

    def stop(progress):
        if progress.recorded == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record(root, progress=stop)
    path = staging_folder(root) / "episodes" / "seed-0000000002.npz"
    os.truncate(path, 100)
    record(root)
    assert files(root) == undisturbed[False]
