import numpy as np
import pytest
from fake_source import FakeSource
from filelock import FileLock

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.recording import staging as staging_module
from lerobot_act_chunking.recording.staging import EpisodeStore, open_staging, staging_folder

MANIFEST = {"source": "fake", "first_seed": 0, "expert": {"speed": 1.0}}


@pytest.fixture
def store(tmp_path):
    return EpisodeStore(tmp_path)


def test_an_episode_comes_back_as_it_was(store):
    episode = FakeSource(camera=True).play(3)
    store.save(episode)
    back = store.load(3)
    assert (back.seed, back.success, back.details) == (3, True, {"mood": "calm"})
    assert back.arrays.keys() == episode.arrays.keys()
    for name, array in episode.arrays.items():
        assert np.array_equal(back.arrays[name], array)
        assert back.arrays[name].dtype == np.float32
    assert back.videos == episode.videos


def test_a_failure_keeps_its_outcome_and_no_frames(store):
    store.save(FakeSource(failing=(2,)).play(2))
    assert store.load(2).arrays == {}
    assert store.outcomes() == {2: False}


@pytest.mark.parametrize("keep", [0.0, 0.5, 0.99])
def test_a_torn_file_is_dropped_and_the_others_are_kept(store, keep):
    for seed in (0, 1):
        store.save(FakeSource().play(seed))
    torn = store.folder / "seed-0000000001.npz"
    content = torn.read_bytes()
    torn.write_bytes(content[: int(keep * len(content))])
    assert store.outcomes() == {0: True}
    assert not torn.exists()


def test_a_flipped_bit_is_noticed(store):
    store.save(FakeSource().play(0))
    path = store.folder / "seed-0000000000.npz"
    content = bytearray(path.read_bytes())
    content[200] ^= 1
    path.write_bytes(content)
    assert store.outcomes() == {}


def test_what_a_killed_writer_left_is_swept(store):
    (store.folder / ".seed-0000000004.npz.123").write_bytes(b"half")
    assert store.outcomes() == {}
    assert list(store.folder.iterdir()) == []


def test_another_manifest_is_refused_and_says_what_differs(tmp_path):
    root = tmp_path / "cube"
    with open_staging(root, MANIFEST):
        pass
    asked = {**MANIFEST, "expert": {"speed": 1.2}, "version of mujoco": "3.9"}
    message = (
        r"\.cube\.recording holds an unfinished recording with other settings \("
        r"expert: \{'speed': 1\.0\}, asked for \{'speed': 1\.2\}, version of mujoco: None, asked for 3\.9\)"
    )
    with pytest.raises(ConfigurationError, match=message), open_staging(root, asked):
        pass


@pytest.mark.parametrize("damage", [b"", b"[" * 100_000, b"[1]", b"\xff"])
def test_a_damaged_manifest_is_refused_and_loses_no_attempt(tmp_path, damage):
    root = tmp_path / "cube"
    with open_staging(root, MANIFEST) as staging:
        staging.store.save(FakeSource().play(0))
    manifest = staging_folder(root) / "manifest.json"
    manifest.write_bytes(damage)
    message = r"manifest\.json is damaged .*remove that file and repeat the command to go on"
    with pytest.raises(ConfigurationError, match=message), open_staging(root, MANIFEST):
        pass
    manifest.unlink()
    with open_staging(root, MANIFEST) as staging:
        assert list(staging.store.outcomes()) == [0]


def test_settings_are_compared_as_json(tmp_path):
    for cameras in (("top",), ["top"]):
        with open_staging(tmp_path / "cube", {"cameras": cameras}):
            assert staging_folder(tmp_path / "cube").is_dir()


def test_a_second_recorder_is_refused(tmp_path):
    root = tmp_path / "cube"
    with open_staging(root, MANIFEST):
        other = FileLock(staging_folder(root) / "lock")
        assert not other.is_locked
        with (
            pytest.raises(ConfigurationError, match="another recorder is at work on"),
            open_staging(root, MANIFEST),
        ):
            pass
    with open_staging(root, MANIFEST):
        pass


def test_a_root_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    for root in (tmp_path / "file" / "cube", tmp_path / "file" / "deeper" / "cube"):
        message = rf"cannot write to {root.parent} \(.*\); choose another root"
        with pytest.raises(ConfigurationError, match=message), open_staging(root, MANIFEST):
            pass


def test_a_half_assembled_dataset_is_swept(tmp_path):
    root = tmp_path / "cube"
    with open_staging(root, MANIFEST) as staging:
        (staging.dataset / "meta").mkdir(parents=True)
    with open_staging(root, MANIFEST) as staging:
        assert not staging.dataset.exists()


def test_publishing_takes_one_step_and_leaves_nothing_behind(tmp_path, monkeypatch):
    root = tmp_path / "cube"
    root.mkdir()
    synced = []
    monkeypatch.setattr(
        staging_module, "sync_tree", lambda folder: synced.append((folder, any(root.iterdir())))
    )
    with open_staging(root, MANIFEST) as staging:
        staging.dataset.mkdir()
        (staging.dataset / "data").write_text("x")
        staging.publish()
    assert synced == [(staging.dataset, False)]  # on the disk before it has its name
    assert [path.name for path in tmp_path.iterdir()] == ["cube"]
    assert (root / "data").read_text() == "x"
