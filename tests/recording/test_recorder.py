"""The whole path with a fake source: what is in the dataset, and what is refused."""

import json
import logging

import numpy as np
import pytest
from fake_source import HEIGHT, WIDTH, FakeSource, files

from lerobot_act_chunking.errors import ConfigurationError, DatasetError
from lerobot_act_chunking.recording import Target, read_summary, record_source


def record(root, episodes=4, source=None, **options):
    target = Target(root, "me/fake", episodes, options.pop("first_seed", 0))
    return record_source(source or FakeSource(), target, **options)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Four episodes without interruption, and without seed 1."""
    root = tmp_path_factory.mktemp("plain") / "data"
    record(root, source=FakeSource(failing=(1,)))
    return root


def load(root, **options):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    return LeRobotDataset("me/fake", root=root, video_backend="pyav", **options)


def test_lerobot_loads_every_frame_as_played(plain):
    dataset = load(plain)
    assert dataset.fps == 10
    assert dataset.meta.robot_type == "fake"
    assert dataset.num_episodes == 4
    rows = [dataset[i] for i in range(len(dataset))]
    played = [FakeSource().play(seed) for seed in (0, 2, 3, 4)]
    assert len(rows) == sum(len(episode) for episode in played)
    for name in ("observation.state", "action"):
        expected = np.concatenate([episode.arrays[name] for episode in played])
        assert np.array_equal(np.stack([row[name].numpy() for row in rows]), expected)
        assert rows[0][name].numpy().dtype == np.float32
    assert {row["task"] for row in rows} == {"Do nothing."}
    assert dataset.meta.features["observation.state"]["names"] == ["x", "y", "z"]


def test_chunks_can_be_asked_for(plain):
    dataset = load(plain, delta_timestamps={"action": [0.0, 0.1, 0.2]})
    assert dataset[0]["action"].shape == (3, 2)
    assert dataset[4]["action_is_pad"].tolist() == [False, True, True]


def test_the_summary_tells_seeds_details_and_versions(plain):
    summary = read_summary(plain)
    assert [entry.seed for entry in summary.episodes] == [0, 2, 3, 4]
    assert [entry.frames for entry in summary.episodes] == [5, 7, 5, 6]
    assert all(entry.success for entry in summary.episodes)
    assert summary.episodes[2].details == {"mood": "calm"}
    assert summary.failed_seeds == (1,)
    assert (summary.attempts, summary.next_seed, summary.frames) == (5, 5, 23)
    assert summary.settings == {"source": "fake", "variant": "plain", "first_seed": 0}
    assert summary.versions == {"fake": "1.0"}


def test_nothing_but_the_dataset_is_left(plain):
    assert [path.name for path in plain.parent.iterdir()] == ["data"]
    assert sorted(files(plain)) == [
        "data/chunk-000/file-000.parquet",
        "meta/episodes/chunk-000/file-000.parquet",
        "meta/info.json",
        "meta/recording.json",
        "meta/stats.json",
        "meta/tasks.parquet",
    ]


def test_workers_do_not_change_a_byte(plain, tmp_path):
    record(tmp_path / "data", source=FakeSource(failing=(1,)), workers=2)
    assert files(tmp_path / "data") == files(plain)


def test_progress_counts_up(tmp_path):
    seen = []
    result = record(tmp_path / "data", 2, FakeSource(failing=(0,)), progress=seen.append)
    assert [(p.recorded, p.failed, p.total) for p in seen] == [(0, 1, 2), (1, 1, 2), (2, 1, 2)]
    assert (result.episodes, result.attempts, result.frames) == (2, 3, 13)
    assert result.expert_success_rate == pytest.approx(2 / 3)
    assert not result.already_complete
    assert result.seconds > 0


def test_a_complete_recording_is_not_made_again(plain, tmp_path):
    before = files(plain)
    log = tmp_path / "log"
    result = record(plain, source=FakeSource(failing=(1,), log=log))
    assert result.already_complete
    assert (result.episodes, result.attempts, result.frames) == (4, 5, 23)
    assert not log.exists()
    assert files(plain) == before


def test_a_complete_recording_does_not_grow(plain):
    message = r"complete recording of 4 episodes, asked for 6; record more into another root with --seed 5"
    with pytest.raises(ConfigurationError, match=message):
        record(plain, 6)


def test_other_settings_are_refused(plain):
    message = r"already holds a recording with other settings \(variant: plain, asked for loud\)"
    with pytest.raises(ConfigurationError, match=message):
        record(plain, source=FakeSource(variant="loud"))
    with pytest.raises(ConfigurationError, match="first_seed: 0, asked for 7"):
        record(plain, first_seed=7)


def test_another_dataset_is_refused_and_stays(plain, tmp_path):
    root = tmp_path / "data"
    (root / "meta").mkdir(parents=True)
    (root / "meta" / "info.json").write_text("{}")
    message = "already holds a LeRobot dataset that act-chunking did not record; choose another root"
    with pytest.raises(ConfigurationError, match=message):
        record(root)
    assert files(root) == {"meta/info.json": b"{}"}


def test_a_folder_with_anything_is_refused_and_stays(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "thesis.tex").write_text("years of work")
    with pytest.raises(ConfigurationError, match=r"already holds something else \(thesis\.tex\); choose"):
        record(tmp_path / "data")
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigurationError, match="already holds a file"):
        record(tmp_path / "file")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data", "file"]


def test_an_empty_folder_is_fine(tmp_path):
    (tmp_path / "data").mkdir()
    assert record(tmp_path / "data", 1).episodes == 1


def test_a_mount_point_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(type(tmp_path), "is_mount", lambda self: True)
    with pytest.raises(ConfigurationError, match="is a mount point; choose a folder inside it"):
        record(tmp_path / "data")


def test_a_damaged_summary_is_told(plain, tmp_path):
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "recording.json").write_text('{"settings": {}')
    with pytest.raises(DatasetError, match=r"recording\.json is damaged"):
        read_summary(tmp_path)
    with pytest.raises(DatasetError, match=r"holds no dataset recorded by act-chunking"):
        read_summary(tmp_path / "absent")


def test_videos_show_what_was_rendered(tmp_path):
    source = FakeSource(camera=True)
    record(tmp_path / "data", 4, source)
    dataset = load(tmp_path / "data")
    assert dataset.meta.features["observation.images.eye"]["shape"] == (HEIGHT, WIDTH, 3)
    frames = [
        frame for seed in range(4) for frame in source.play(seed).videos["observation.images.eye"].frames()
    ]
    assert len(frames) == len(dataset)
    for i, frame in enumerate(frames):
        shown = dataset[i]["observation.images.eye"].numpy() * 255
        assert shown.shape == (3, HEIGHT, WIDTH)
        assert np.abs(shown - frame.transpose(2, 0, 1)).max() < 2.4  # neighbours differ by 5
    stats = dataset.meta.stats["observation.images.eye"]
    assert stats["mean"].shape == (3, 1, 1)
    assert stats["mean"].max() <= 1


def test_a_video_that_lost_frames_is_an_error(tmp_path, monkeypatch):
    from lerobot.datasets.video_utils import StreamingVideoEncoder

    feed = StreamingVideoEncoder.feed_frame
    fed = []

    def drop_one(self, key, image):
        fed.append(key)
        if len(fed) != 3:
            feed(self, key, image)

    monkeypatch.setattr(StreamingVideoEncoder, "feed_frame", drop_one)
    message = r"the video observation\.images\.eye of episode 0 has 4 of 5 frames"
    with pytest.raises(DatasetError, match=message):
        record(tmp_path / "data", 2, FakeSource(camera=True))
    assert not (tmp_path / "data").exists()


def test_recording_is_silent(tmp_path, capfd, caplog):
    with caplog.at_level(logging.WARNING):
        record(tmp_path / "data", 2, FakeSource(camera=True))
    assert capfd.readouterr() == ("", "")
    assert caplog.messages == []


def test_statistics_are_lerobots(plain):
    from lerobot.datasets.io_utils import load_stats

    stats = load_stats(plain)
    actions = np.concatenate([FakeSource().play(seed).arrays["action"] for seed in (0, 2, 3, 4)])
    np.testing.assert_allclose(stats["action"]["mean"], actions.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(stats["action"]["std"], actions.std(axis=0), atol=1e-6)
    assert json.loads((plain / "meta" / "stats.json").read_text()).keys() == stats.keys()
