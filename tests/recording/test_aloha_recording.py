"""Demonstrations of the real simulator and experts."""

from importlib.metadata import version

import numpy as np
import pytest
from fake_source import files
from tiers import full_tier

from lerobot_act_chunking.envs.aloha.env import AlohaSimEnv
from lerobot_act_chunking.envs.demonstration import ExpertOptions
from lerobot_act_chunking.errors import ConfigurationError, DatasetError
from lerobot_act_chunking.recording import AlohaSource, RecordSpec, read_summary, record
from lerobot_act_chunking.recording.episode import Episode, check_episode

TINY = {"cameras": ("top", "left_wrist"), "image_height": 32, "image_width": 48, "render_quality": "fast"}


def source(**options):
    return RecordSpec("me/cube", **options).source()


def play(seed, **options):
    aloha = source(**options)
    with aloha.open() as play:
        episode = play(seed)
    check_episode(episode, aloha.format)
    return episode


def test_recorded_actions_replayed_in_the_environment_show_the_recorded_states():
    episode = play(3, velocity=True)
    env = AlohaSimEnv(success="hold", agent_vel=True)
    observation, info = env.reset(seed=3)
    for t in range(len(episode)):
        np.testing.assert_allclose(
            episode.arrays["observation.state"][t], observation["agent_pos"], atol=1e-4
        )
        np.testing.assert_allclose(
            episode.arrays["observation.environment_state"][t], observation["environment_state"], atol=1e-4
        )
        assert episode.arrays["observation.agent_vel"][t].shape == observation["agent_vel"].shape
        observation, _, _, _, info = env.step(episode.arrays["action"][t])
    assert info["is_success"]
    assert episode.success
    assert episode.details["success_touch"]
    assert episode.details["success_hold"]


def test_the_first_row_is_before_any_action():
    episode = play(5)
    observation, _ = AlohaSimEnv().reset(seed=5)
    for feature, name in (("state", "agent_pos"), ("environment_state", "environment_state")):
        expected = observation[name].astype(np.float32)
        assert np.array_equal(episode.arrays[f"observation.{feature}"][0], expected)


def test_labels_are_clean_where_commands_are_disturbed():
    quiet, noisy = (play(2, expert=ExpertOptions(action_noise=noise)) for noise in (0.0, 0.01))
    assert np.array_equal(quiet.arrays["action"], noisy.arrays["action"])
    difference = np.abs(quiet.arrays["observation.state"] - noisy.arrays["observation.state"]).max(axis=0)
    arms = np.delete(difference, [6, 13])
    assert 0.005 < arms.min() < arms.max() < 0.1  # grippers yield to what they hold
    assert noisy.details["expert"]["action_noise"] == 0.01


def test_an_episode_depends_on_its_seed_alone():
    aloha = source(expert=ExpertOptions(waypoint_noise=0.005, action_noise=0.005))
    with aloha.open() as one:
        one(0)
        after_another = one(1)
    with aloha.open() as two:
        alone, next_seed = two(1), two(2)
    for name, array in alone.arrays.items():
        assert np.array_equal(array, after_another.arrays[name])
    assert not np.array_equal(alone.arrays["action"][:50], next_seed.arrays["action"][:50])


@pytest.mark.parametrize(
    ("options", "features"),
    [
        ({}, {"observation.state": 14, "observation.environment_state": 7, "action": 14}),
        (
            {"task": "insertion", "velocity": True},
            {
                "observation.state": 14,
                "observation.agent_vel": 14,
                "observation.environment_state": 14,
                "action": 14,
            },
        ),
        (
            {"obs": "pixels", **TINY},
            {
                "observation.images.top": (32, 48, 3),
                "observation.images.left_wrist": (32, 48, 3),
                "action": 14,
            },
        ),
        (
            {"obs": "pixels_state", "image_height": 16, "image_width": 18},
            {"observation.state": 14, "observation.images.top": (16, 18, 3), "action": 14},
        ),
    ],
)
def test_features(options, features):
    form = source(**options).format
    shapes = {name: entry["shape"] for name, entry in form.features.items()}
    assert shapes == {name: s if isinstance(s, tuple) else (s,) for name, s in features.items()}
    assert all(len(entry["names"]) == entry["shape"][0] for entry in form.arrays.values())
    assert form.fps == 50


def test_names_tell_every_entry():
    form = source(task="insertion").format
    assert form.features["action"]["names"][7:9] == ["right_arm_waist", "right_arm_shoulder"]
    assert form.features["observation.state"]["names"] == form.features["action"]["names"]
    names = form.features["observation.environment_state"]["names"]
    assert names[:4] == ["peg_x", "peg_y", "peg_z", "peg_qw"]
    assert names[7] == "socket_x"
    assert form.task == "Insert the peg into the socket."


def test_images_are_what_the_camera_sees():
    episode = play(4, obs="pixels_state", **TINY)
    env = AlohaSimEnv(obs_type="pixels", cameras=["left_wrist"], observation_height=32, observation_width=48,
                      render_quality="fast")  # fmt: skip
    observation, _ = env.reset(seed=4)
    frames = list(episode.videos["observation.images.left_wrist"].frames())
    assert np.array_equal(frames[0], observation["pixels"]["left_wrist"])
    assert not np.array_equal(frames[0], frames[150])
    env.close()


def test_settings_leave_out_what_does_not_matter():
    assert "cameras" not in source().settings
    assert source(image_height=100).settings == source().settings
    assert source(obs="pixels", image_height=100).settings != source(obs="pixels").settings
    assert source(expert=ExpertOptions(speed=1.2)).settings != source().settings


def test_a_dataset_that_lerobot_loads(tmp_path):
    result = record(RecordSpec("me/cube", tmp_path / "one", episodes=2, workers=1))
    record(RecordSpec("me/cube", tmp_path / "two", episodes=2, workers=2))
    assert files(tmp_path / "one") == files(tmp_path / "two")

    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("me/cube", root=tmp_path / "one", video_backend="pyav")
    assert (dataset.num_episodes, dataset.num_frames, dataset.fps) == (2, result.frames, 50)
    assert dataset[0]["observation.environment_state"].shape == (7,)
    assert dataset[0]["task"].startswith("Pick up the cube")
    summary = read_summary(tmp_path / "one")
    assert [entry.seed for entry in summary.episodes] == [0, 1]
    assert summary.versions["mujoco"] == version("mujoco")
    assert summary.versions["lerobot_policy_act_chunking"] == version("lerobot_policy_act_chunking")
    assert summary.episodes[1].details["expert"] == {
        "speed": 1.0,
        "waypoint_noise": 0.0,
        "action_noise": 0.0,
        "dwell": 0.0,
    }


def test_only_successes_are_recorded(tmp_path, monkeypatch):
    real = AlohaSource.play

    def lucky(self, env, seed):
        episode = real(self, env, seed)
        return episode if seed != 1 else Episode(seed, False, {})

    monkeypatch.setattr(AlohaSource, "play", lucky)
    record(RecordSpec("me/cube", tmp_path / "data", episodes=2))
    summary = read_summary(tmp_path / "data")
    assert [entry.seed for entry in summary.episodes] == [0, 2]
    assert summary.failed_seeds == (1,)


def test_an_expert_that_never_succeeds_is_an_error(tmp_path, monkeypatch):
    monkeypatch.setattr(AlohaSource, "play", lambda self, env, seed: Episode(seed, False, {}))
    message = "20 attempts in a row failed, up to seed 26; ask the expert for less noise"
    with pytest.raises(DatasetError, match=message):
        record(RecordSpec("me/cube", tmp_path / "data", episodes=1, seed=7))
    assert not (tmp_path / "data").exists()


def test_the_root_is_by_default_where_lerobot_looks(tmp_path, monkeypatch):
    monkeypatch.setattr("lerobot.utils.constants.HF_LEROBOT_HOME", tmp_path)
    assert record(RecordSpec("me/cube", episodes=1)).root == tmp_path / "me" / "cube"
    assert read_summary(tmp_path / "me" / "cube").episodes[0].seed == 0


def test_a_relative_root_and_a_file_in_the_way(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").write_text("")
    with pytest.raises(ConfigurationError, match=f"{tmp_path}/taken already holds a file"):
        record(RecordSpec("me/cube", root=type(tmp_path)("taken")))


@full_tier
def test_cameras_do_not_depend_on_the_workers(tmp_path):
    for workers in (1, 2):
        spec = RecordSpec(
            "me/cube", tmp_path / str(workers), obs="pixels_state", episodes=3, workers=workers, **TINY
        )
        record(spec)
    assert files(tmp_path / "1") == files(tmp_path / "2")
