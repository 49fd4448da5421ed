"""People with habits as demonstrators."""

import numpy as np
import pytest
from fake_source import files
from typer.testing import CliRunner

from lerobot_act_chunking.cli.main import app
from lerobot_act_chunking.envs.demonstration import ExpertOptions
from lerobot_act_chunking.envs.operators import OPERATORS
from lerobot_act_chunking.envs.robotics.experts import Expert
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.recording import RecordSpec, read_summary, record


def source(**options):
    return RecordSpec("me/cube", **options).source()


def test_operators_take_turns_and_are_kept_with_the_episodes(tmp_path):
    spec = RecordSpec("me/cube", root=tmp_path / "both", episodes=4, operators=("brisk", "clumsy"), workers=2)
    result = record(spec)
    summary = read_summary(tmp_path / "both")
    assert all(
        episode.details["operator"] == ("brisk", "clumsy")[episode.seed % 2] for episode in summary.episodes
    )
    assert set(summary.settings["operators"]) == {"brisk", "clumsy"}
    assert summary.settings["operators"]["clumsy"]["miss_rate"] > 0
    assert sum(attempts for _, attempts in result.operators.values()) == result.attempts
    assert len({episode.frames for episode in summary.episodes}) > 1
    alone = record(RecordSpec("me/cube", root=tmp_path / "one", episodes=4, operators=("brisk", "clumsy")))
    assert alone.frames == result.frames
    assert files(tmp_path / "one") == files(tmp_path / "both")


def test_frames_that_the_recording_misses_are_left_out():
    full, gaps = (source(expert=ExpertOptions(dropped_frames=share)) for share in (0.0, 0.1))
    with full.open() as play_full, gaps.open() as play_gaps:
        whole, part = play_full(3), play_gaps(3)
    assert part.success
    assert 0.8 * len(whole) < len(part) < 0.97 * len(whole)
    rows = {row.tobytes() for row in whole.arrays["action"]}
    assert all(row.tobytes() in rows for row in part.arrays["action"])
    assert np.array_equal(part.arrays["action"][0], whole.arrays["action"][0])


def test_a_fetch_operator_misses_a_grasp_and_succeeds():
    fetch = source(
        env="gymnasium_robotics", task="FetchPickAndPlace-v4", expert=ExpertOptions(missed_grasps=1)
    )
    with fetch.open() as play:
        episode = play(0)
    fingers = episode.arrays["action"][:, 3]
    assert episode.success
    assert np.sum(np.diff((fingers < 0).astype(int)) == 1) == 2


def fetch_actions(**options):
    fetch = source(env="gymnasium_robotics", task="FetchPickAndPlace-v4", expert=ExpertOptions(**options))
    with fetch.open() as play:
        return play(0).arrays["action"]


def test_a_fetch_operator_rests_first():
    plain, rested = fetch_actions(), fetch_actions(idle_start=0.2)
    assert np.abs(plain[:5, :3]).max() > 0.5
    assert np.abs(rested[:5, :3]).max() == 0
    assert np.abs(rested[5, :3]).max() > 0.5


def test_a_fetch_operator_rests_after_the_grasp():
    def still_and_closed(actions):
        return int(np.sum((np.abs(actions[:, :3]).max(axis=1) == 0) & (actions[:, 3] < 0)))

    assert still_and_closed(fetch_actions(dwell_after=0.2)) - still_and_closed(fetch_actions()) == 5


def test_a_fetch_operators_commands_come_late():
    expert = Expert("FetchReach-v4", ExpertOptions(latency=0.04), np.random.default_rng(0), 50)
    observation = {"grip_pos": np.zeros(3), "desired_goal": np.array([0.1, 0.0, 0.0])}
    first, executed = expert.act(observation)
    assert np.abs(first[:3]).max() > 0.5
    assert np.abs(executed).max() == 0
    second, executed = expert.act({**observation, "grip_pos": np.array([0.08, 0.0, 0.0])})
    np.testing.assert_array_equal(executed, first)
    assert not np.array_equal(second, first)


def test_every_episode_of_a_person_is_its_own():
    brisk = source(operators=("brisk",))
    assert brisk.options_of(3) == brisk.options_of(3)
    assert len({brisk.options_of(seed).speed for seed in range(5)}) == 5


def test_habits_and_options_together_are_refused():
    with pytest.raises(ConfigurationError, match="operators brisk have habits of their own: leave out"):
        source(operators=("brisk",), expert=ExpertOptions(speed=1.1))
    with pytest.raises(ConfigurationError, match="unknown operator 'bob'; choose one of: steady"):
        source(operators=("bob",))


def test_the_command_says_who_was_discarded(tmp_path):
    words = ["record", "--repo-id", "me/cube", "--root", str(tmp_path / "cube"), "--episodes", "2"]
    result = CliRunner().invoke(app, [*words, "--operators", "brisk,unhurried"])
    assert result.exit_code == 0, result.output
    assert "brisk: 0 of 1 attempts discarded" in result.output
    assert "unhurried: 0 of 1 attempts discarded" in result.output


def test_help_names_every_operator():
    shown = " ".join(CliRunner().invoke(app, ["record", "--help"], env={"COLUMNS": "300"}).output.split())
    assert ", ".join(OPERATORS) in shown
