"""Demonstrations of the Fetch experts, recorded by the recorder that records ALOHA's."""

from importlib.metadata import version

import numpy as np
import pytest
from fake_source import files

from lerobot_act_chunking.envs.demonstration import ExpertOptions
from lerobot_act_chunking.envs.robotics.env import RoboticsEnv
from lerobot_act_chunking.envs.robotics.experts import EXPERTS
from lerobot_act_chunking.recording import RecordSpec, read_summary, record
from lerobot_act_chunking.recording.episode import check_episode

PUSH = {"env": "gymnasium_robotics", "task": "FetchPush-v4"}


def source(**options):
    return RecordSpec("me/fetch", **{**PUSH, **options}).source()


def play(seed, **options):
    fetch = source(**options)
    with fetch.open() as play:
        episode = play(seed)
    check_episode(episode, fetch.format)
    return episode


@pytest.mark.parametrize("task", EXPERTS)
def test_recorded_actions_replayed_in_the_environment_show_the_recorded_states(task):
    episode = play(3, task=task)
    env = RoboticsEnv(task=task, success="final")
    observation, info = env.reset(seed=3)
    for t in range(len(episode)):
        state = episode.arrays["observation.state"][t]
        surroundings = episode.arrays["observation.environment_state"][t]
        np.testing.assert_allclose(state, observation["agent_pos"], atol=1e-3)
        np.testing.assert_allclose(surroundings, observation["environment_state"], atol=1e-3)
        observation, *_, info = env.step(episode.arrays["action"][t])
    env.close()
    assert info["is_success"] == episode.success
    assert episode.details["success_final"] == episode.success


def test_velocities_are_recorded_unless_they_are_not_wanted():
    with_them, without = play(3), play(3, velocity=False)
    names = source(velocity=False).format.features["observation.state"]["names"]
    assert names == ["grip_pos_0", "grip_pos_1", "grip_pos_2", "gripper_state_0", "gripper_state_1"]
    assert [episode.arrays["observation.state"].shape[1] for episode in (with_them, without)] == [10, 5]
    for key, kept in (("observation.state", 5), ("action", 4)):  # of the robot, velocities come last
        assert np.array_equal(with_them.arrays[key][:, :kept], without.arrays[key])


def test_the_first_row_is_before_any_action():
    episode = play(5)
    env = RoboticsEnv(task="FetchPush-v4")
    observation, _ = env.reset(seed=5)
    env.close()
    for feature, name in (("state", "agent_pos"), ("environment_state", "environment_state")):
        expected = observation[name].astype(np.float32)
        assert np.array_equal(episode.arrays[f"observation.{feature}"][0], expected)


def test_final_episodes_last_to_the_end_and_any_ends_at_the_first_success():
    final, first = play(2), play(2, success="any")
    assert len(final) == 50
    assert final.details["success_any"]
    assert len(first) < 50
    assert first.success
    steps = slice(0, len(first))
    assert np.array_equal(final.arrays["action"][steps], first.arrays["action"])


def test_labels_are_clean_where_commands_are_disturbed():
    quiet, noisy = (play(2, expert=ExpertOptions(action_noise=noise)) for noise in (0.0, 0.1))
    assert np.array_equal(quiet.arrays["action"][0], noisy.arrays["action"][0])
    second = noisy.arrays["observation.state"][1] - quiet.arrays["observation.state"][1]
    assert 1e-4 < np.abs(second[:3]).max() < 0.02  # the gripper went elsewhere
    assert noisy.details["expert"]["action_noise"] == 0.1


def test_an_episode_depends_on_its_seed_alone():
    fetch = source(expert=ExpertOptions(waypoint_noise=0.01, action_noise=0.05, dwell=0.1))
    with fetch.open() as one:
        one(0)
        after_another = one(1)
    with fetch.open() as two:
        alone, next_seed = two(1), two(2)
    for name, array in alone.arrays.items():
        assert np.array_equal(array, after_another.arrays[name])
    assert not np.array_equal(alone.arrays["action"], next_seed.arrays["action"])


def test_pixels_are_recorded_while_the_expert_knows_the_state():
    options = {"image_height": 16, "image_width": 18, "render_quality": "fast", "success": "any"}
    episode = play(4, obs="pixels", cameras=("external_camera_0",), **options)
    assert np.array_equal(episode.arrays["action"], play(4, success="any").arrays["action"])
    env = RoboticsEnv(
        task="FetchPush-v4", obs_type="pixels", cameras=["external_camera_0"],
        observation_height=16, observation_width=18, render_quality="fast",
    )  # fmt: skip
    observation, _ = env.reset(seed=4)
    env.close()
    frames = list(episode.videos["observation.images.external_camera_0"].frames())
    assert np.array_equal(frames[0], observation["pixels"]["external_camera_0"])


def test_names_tell_every_entry():
    form = source().format
    assert (form.fps, form.robot_type) == (25, "fetch")
    assert form.task == "Push the block to the target."
    assert form.features["action"]["names"] == ["x", "y", "z", "gripper"]
    assert form.features["observation.state"]["names"][:4] == [
        *("grip_pos_0", "grip_pos_1", "grip_pos_2", "gripper_state_0"),
    ]
    assert form.features["observation.environment_state"]["names"][-1] == "desired_goal_2"


def test_a_dataset_that_lerobot_loads(tmp_path):
    for workers in (1, 2):
        record(RecordSpec("me/fetch", tmp_path / str(workers), episodes=2, workers=workers, **PUSH))
    assert files(tmp_path / "1") == files(tmp_path / "2")

    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("me/fetch", root=tmp_path / "1", video_backend="pyav")
    assert (dataset.num_episodes, dataset.num_frames, dataset.fps) == (2, 100, 25)
    assert dataset[0]["observation.environment_state"].shape == (18,)
    summary = read_summary(tmp_path / "1")
    assert summary.settings["task"] == "FetchPush-v4"
    assert summary.settings["success"] == "final"
    assert summary.versions["gymnasium-robotics"] == version("gymnasium-robotics")
