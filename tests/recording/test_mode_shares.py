"""How often a recording shows each way: exactly as asked, whatever fails and whoever demonstrates."""

from collections import Counter

import numpy as np
import pytest
from fake_source import files
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from lerobot_act_chunking.cli.main import app
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.recording import ModeShares, RecordSpec, ThreeGatesSource, read_summary, record
from lerobot_act_chunking.recording.attempts import AttemptQueue
from lerobot_act_chunking.recording.episode import Episode, check_episode
from lerobot_act_chunking.recording.shares import ONE_WAY

SHARES = ModeShares((80.0, 15.0, 5.0))
WEIGHTS = st.lists(st.integers(0, 100), min_size=1, max_size=5).filter(any)


def percentages(weights):
    return tuple((100 * np.array(weights) / sum(weights)).tolist())


class Runner:
    """Fails the given seeds; remembers what was asked for, and what it played."""

    def __init__(self, failing=()):
        self.failing, self.submitted, self.played = failing, [], []

    def submit(self, seed):
        self.submitted.append(seed)

    def succeeded(self, seed):
        self.played.append(seed)
        return seed not in self.failing


def recorded(shares, episodes, ahead=1, failing=(), first_seed=0, known=None):
    """Seeds of the successes, in order, and those that failed."""
    queue = AttemptQueue(Runner(failing), known or {}, first_seed, episodes, ahead, shares)
    outcomes = list(queue)
    return [seed for seed, success in outcomes if success], [
        seed for seed, success in outcomes if not success
    ]


@given(WEIGHTS, st.integers(0, 500))
def test_counts_are_the_nearest_whole_numbers(weights, episodes):
    shares = ModeShares(percentages(weights))
    counts = shares.counts(episodes)
    exact = np.array(shares.percentages) * episodes / 100
    assert sum(counts) == episodes
    assert np.all(np.abs(counts - exact) < 1)
    assert all(count == 0 for count, weight in zip(counts, weights, strict=True) if not weight)


@pytest.mark.parametrize(
    ("asked", "episodes", "counts"),
    [
        ((80, 15, 5), 100, [80, 15, 5]),
        ((80, 15, 5), 200, [160, 30, 10]),
        ((80, 15, 5), 50, [40, 8, 2]),
        ((), 50, [17, 17, 16]),
        ((), 300, [100, 100, 100]),
        ((0, 0, 100), 7, [0, 0, 7]),
        ((33.3, 33.3, 33.4), 1000, [333, 333, 334]),
    ],
)
def test_counts(asked, episodes, counts):
    assert ModeShares.of_task(3, asked).counts(episodes) == counts


@given(WEIGHTS, st.integers(0, 2**32), st.integers(20, 200), st.integers(1, 5))
def test_any_run_of_seeds_has_nearly_the_shares_for_each_person(weights, first, n, people):
    shares = ModeShares(percentages(weights))
    modes = Counter(shares.mode_of(seed) for seed in range(first, first + n * people, people))
    for mode, percentage in enumerate(shares.percentages):
        assert abs(modes[mode] - n * percentage / 100) < 5
        assert percentage or not modes[mode]


@pytest.mark.parametrize(("shares", "mode"), [((0.0, 100.0), 1), ((0.0, 0.0, 100.0), 2), ((100.0, 0.0), 0)])
def test_a_way_without_a_share_has_no_seed(shares, mode):
    assert {ModeShares(shares).mode_of(seed) for seed in range(50)} == {mode}


@given(WEIGHTS, st.integers(1, 60), st.sets(st.integers(0, 100), max_size=15), st.integers(0, 30))
def test_a_recording_has_exactly_the_shares_whatever_fails(weights, episodes, failing, first_seed):
    shares = ModeShares(percentages(weights))
    seeds, failed = recorded(shares, episodes, failing=failing, first_seed=first_seed)
    modes = Counter(map(shares.mode_of, seeds))
    assert [modes[mode] for mode in range(len(weights))] == shares.counts(episodes)
    assert seeds == sorted(set(seeds))
    assert set(failed) <= failing
    for ahead in (4, 16):
        assert recorded(shares, episodes, ahead, failing, first_seed) == (seeds, failed)


def test_what_no_way_needs_is_not_played():
    runner = Runner()
    seeds = [seed for seed, _ in AttemptQueue(runner, {}, 0, 20, ahead=1, shares=SHARES)]
    assert runner.submitted == runner.played == seeds
    assert len(seeds) == 20
    assert seeds[-1] > 19  # some seeds were passed over


def test_known_outcomes_are_taken_as_they_are():
    known = {seed: seed != 2 for seed in range(10)}
    assert recorded(SHARES, 20, known=known) == recorded(SHARES, 20, failing={2})


def test_one_way_passes_over_nothing():
    assert recorded(ONE_WAY, 5, failing={1}) == ([0, 2, 3, 4, 5], [1])


@pytest.mark.parametrize(
    ("modes", "asked", "message"),
    [
        (3, (80, 20), "mode_shares 80,20: 2 shares of a task with 3 modes; give 3 percentages that sum to"),
        (3, (80, 10, 5, 5), "mode_shares 80,10,5,5: 4 shares of a task with 3 modes; give 3 percentages"),
        (3, (80, 25, -5), "mode_shares 80,25,-5: no share is negative; give 3 percentages that sum to 100"),
        (3, (80, 15, 6), "mode_shares 80,15,6: the shares sum to 101; give 3 percentages that sum to 100"),
        (3, (0.8, 0.15, 0.05), "the shares sum to 1; give 3 percentages that sum to 100, as in 80,15,5"),
        (3, (float("nan"), 50, 50), "no share is negative"),
        (3, (float("inf"), 0, 0), "the shares sum to inf"),
        (1, (100,), "mode_shares 100: the task is done one way only; leave the shares out"),
    ],
)
def test_shares_that_cannot_be_are_refused(modes, asked, message):
    with pytest.raises(ConfigurationError) as caught:
        ModeShares.of_task(modes, asked)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--env", "three_gates", "--mode-shares", "80,20"], "2 shares of a task with 3 modes"),
        (["--task", "transfer_modes", "--mode-shares", "90,15,-5"], "no share is negative"),
        (["--task", "transfer_modes", "--mode-shares", "80,15,6"], "the shares sum to 101"),
        (["--task", "transfer_modes", "--mode-shares", "most"], "mode_shares 'most' are percentages with"),
        (["--mode-shares", "50,50"], "the task is done one way only"),
    ],
)
def test_the_command_refuses_them_before_anything_starts(options, message, tmp_path):
    words = ["record", "--repo-id", "me/data", "--root", str(tmp_path / "data"), *options]
    result = CliRunner().invoke(app, words)
    assert message in str(result.exception)
    assert list(tmp_path.iterdir()) == []


def gates(root, episodes=40, **options):
    options = {"mode_shares": (80, 15, 5), **options}
    return record(RecordSpec("me/gates", root, env="three_gates", episodes=episodes, **options))


def modes_in(root):
    return Counter(episode.details["mode"] for episode in read_summary(root).episodes)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    root = tmp_path_factory.mktemp("gates") / "data"
    gates(root)
    return root


def test_a_dataset_keeps_the_way_of_each_episode(undisturbed):
    summary = read_summary(undisturbed)
    assert modes_in(undisturbed) == {0: 32, 1: 6, 2: 2}
    assert summary.settings["mode_shares"] == [80.0, 15.0, 5.0]
    assert summary.modes == {0: (0, 32), 1: (0, 6), 2: (0, 2)}
    assert summary.next_seed == summary.episodes[-1].seed + 1
    assert all(episode.details["mode"] == SHARES.mode_of(episode.seed) for episode in summary.episodes)

    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("me/gates", root=undisturbed, video_backend="pyav")
    assert (dataset.num_episodes, dataset.fps) == (40, 10)
    ends = np.cumsum([episode.frames for episode in summary.episodes]) - 1
    towards = {0: (0, 1), 1: (-1, -1), 2: (1, -1)}
    for end, episode in zip(ends, summary.episodes, strict=True):
        action = dataset[int(end)]["action"].numpy()
        assert np.all(np.sign(action.round(2)) == towards[episode.details["mode"]])


def test_workers_do_not_change_a_byte(undisturbed, tmp_path):
    gates(tmp_path / "data", workers=2)
    assert files(tmp_path / "data") == files(undisturbed)


def test_an_interrupted_recording_resumes_to_the_very_dataset(undisturbed, tmp_path):
    def stop(progress):
        if progress.recorded == 21:
            raise KeyboardInterrupt

    spec = RecordSpec("me/gates", tmp_path / "data", env="three_gates", episodes=40, mode_shares=(80, 15, 5))
    with pytest.raises(KeyboardInterrupt):
        record(spec, progress=stop)
    with pytest.raises(ConfigurationError, match="unfinished recording with other settings"):
        gates(tmp_path / "data", mode_shares=(70, 20, 10))
    record(spec)
    assert files(tmp_path / "data") == files(undisturbed)


def test_a_failed_attempt_is_made_up_for_by_one_of_its_way(tmp_path, monkeypatch):
    play, rare = ThreeGatesSource.play, [seed for seed in range(100) if SHARES.mode_of(seed) == 2][:2]

    def unlucky(self, env, seed):
        return Episode(seed, False, {}) if seed in rare else play(self, env, seed)

    monkeypatch.setattr(ThreeGatesSource, "play", unlucky)
    result = gates(tmp_path / "data", episodes=20)
    assert modes_in(tmp_path / "data") == {0: 16, 1: 3, 2: 1}
    assert result.modes == {0: (0, 16), 1: (0, 3), 2: (2, 3)}
    assert set(read_summary(tmp_path / "data").failed_seeds) == set(rare)


def test_an_episode_that_goes_another_way_is_no_demonstration(monkeypatch):
    source = RecordSpec("me/gates", env="three_gates").source()
    with source.open() as play:
        seed = next(seed for seed in range(10) if source.mode_of(seed) == 1)
        assert play(seed).success
        monkeypatch.setattr("lerobot_act_chunking.envs.three_gates.env.gate_of", lambda position: 0)
        assert not play(seed).success


def test_people_and_ways_go_together(tmp_path):
    result = gates(tmp_path / "data", episodes=12, mode_shares=(), operators=("steady", "brisk", "shaky"))
    summary = read_summary(tmp_path / "data")
    assert modes_in(tmp_path / "data") == {0: 4, 1: 4, 2: 4}
    assert sum(attempts for _, attempts in result.operators.values()) == result.attempts
    together = {(episode.details["operator"], episode.details["mode"]) for episode in summary.episodes}
    assert len(together) > 6
    assert all(len({mode for name, mode in together if name == each}) > 1 for each in result.operators)


def test_transfer_modes_is_recorded_with_its_ways(tmp_path):
    spec = RecordSpec("me/ways", tmp_path / "data", task="transfer_modes", episodes=3)
    assert record(spec).modes == {0: (0, 1), 1: (0, 1), 2: (0, 1)}
    assert modes_in(tmp_path / "data") == {0: 1, 1: 1, 2: 1}
    assert "mode_shares" not in RecordSpec("me/cube").source().settings


@pytest.mark.parametrize(
    ("options", "features"),
    [
        ({}, {"observation.state": 2, "observation.environment_state": 6, "action": 2}),
        ({"velocity": True}, {"observation.agent_vel": 2}),
        (
            {"obs": "pixels_state", "image_height": 16, "image_width": 18},
            {"observation.state": 2, "observation.images.top": 16},
        ),
    ],
    ids=str,
)
def test_features_of_the_three_gates(options, features):
    source = RecordSpec("me/gates", env="three_gates", **options).source()
    shapes = {name: entry["shape"][0] for name, entry in source.format.features.items()}
    assert features.items() <= shapes.items()
    with source.open() as play:
        check_episode(play(1), source.format)
    names = source.format.features["action"]["names"]
    assert names == ["target_x", "target_y"]


def test_the_command_says_how_often_each_way_was_discarded(tmp_path):
    words = ["record", "--env", "three_gates", "--repo-id", "me/gates", "--root", str(tmp_path / "gates")]
    result = CliRunner().invoke(app, [*words, "--episodes", "4", "--mode-shares", "50, 0, 50"])
    assert result.exit_code == 0, result.output
    assert "mode 0: 0 of 2 attempts discarded" in result.output
    assert "mode 1: 0 of 0 attempts discarded" in result.output
    assert "mode 2: 0 of 2 attempts discarded" in result.output
