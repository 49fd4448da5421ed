"""When an episode is lost, and whether its environment repeats itself."""

import numpy as np
import pytest
from line_environment import LineConfig

from lerobot_act_chunking.diagnostics.core.played import Episode
from lerobot_act_chunking.diagnostics.diagnose.moments import find_moments, repeats_itself
from lerobot_act_chunking.diagnostics.diagnose.records import Record, keep, read_kept
from lerobot_act_chunking.diagnostics.diagnose.trials import Trial
from lerobot_act_chunking.errors import ConfigurationError

FIRST, SECOND = Trial("latency", "first"), Trial("jitter", "second")


def record(seed=1, steps=64, rewards=None):
    episode = Episode(seed, False, {}, 0.0, 0.0, steps, "truncated", None, 0.0, 1, None, None)
    commands = np.zeros((steps, 2))
    return Record(episode, commands, commands, np.zeros(steps) if rewards is None else rewards, 0.1)


class Fake:
    """Saves an episode if a trial takes over up to a step."""

    def __init__(self, until):
        self.until, self.asked = until, []

    def try_out(self, plan, given):
        self.asked.append({seed: len(commands) for seed, commands in given.items()})
        return {
            trial: {seed: len(given[seed]) <= self.until[trial] for seed in seeds}
            for trial, seeds in plan.items()
        }


def test_time_is_halved_until_it_is_known():
    moments = find_moments(Fake({FIRST: 20}), [FIRST], {1: record()}, [1])
    assert moments.good[1] <= 20 < moments.lost[1]
    assert moments.lost[1] - moments.good[1] <= 64 / 4


def test_the_search_begins_where_progress_ends():
    rewards = np.r_[np.zeros(30), np.ones(34)]
    lab = Fake({FIRST: 40})
    moments = find_moments(lab, [FIRST], {1: record(rewards=rewards)}, [1])
    assert lab.asked[0] == {1: 30}
    assert 30 <= moments.good[1] <= 40 < moments.lost[1]


def test_a_state_is_good_if_any_of_them_saves_it():
    moments = find_moments(Fake({FIRST: 0, SECOND: 50}), [FIRST, SECOND], {1: record()}, [1])
    assert 32 <= moments.good[1] <= 50 < moments.lost[1]
    assert moments.found[FIRST] == {1: False}
    assert moments.found[SECOND] == {1: True}


@pytest.fixture
def played():
    """An episode of the line, with commands that vary."""
    config = LineConfig(width=2)
    config.ends.success = 9.0
    env = next(iter(config.create_envs(1)["line"].values())).envs[0]
    observation, _ = env.reset(seed=5)
    commands, states, rewards = 0.1 * np.arange(16.0).reshape(8, 2), [], []
    for command in commands:
        states.append(observation["agent_pos"])
        observation, reward, *_ = env.step(command)
        rewards.append(reward)
    episode = Episode(5, False, {}, 0.0, 0.0, 8, "cut", None, 0.0, 1, None, None)
    return config, Record(episode, commands, np.stack(states), np.array(rewards), 0.1)


def test_an_environment_that_repeats_itself(played):
    config, record = played
    policy = type("Config", (), {"type": "act", "input_features": {}})()
    assert repeats_itself(config, policy, [record])
    other = Record(record.episode, record.commands, record.states + 1e-9, record.rewards, record.dt)
    assert not repeats_itself(config, policy, [other])


def test_episodes_are_kept_to_the_bit(played, tmp_path):
    _, record = played
    keep([record, record], tmp_path / "00000")
    again = read_kept(tmp_path / "00000")
    assert [each.episode for each in again] == [record.episode] * 2
    assert np.array_equal(again[1].commands, record.commands)
    assert np.array_equal(again[1].rewards, record.rewards)
    assert read_kept(tmp_path / "00001") is None
    (tmp_path / "00000.npz").write_bytes(b"damaged")
    with pytest.raises(ConfigurationError, match="remove it, and its episodes run again"):
        read_kept(tmp_path / "00000")
