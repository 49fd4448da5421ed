import pytest

from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.errors import ConfigurationError


def test_steps_relative_to_now():
    timing = ChunkTiming(n_obs_steps=3, chunk_size=5, n_action_steps=2)
    assert timing.observation_deltas == [-2, -1, 0]
    assert timing.action_deltas == [0, 1, 2, 3, 4]


def test_one_observation_has_no_time_axis():
    assert ChunkTiming(n_obs_steps=1, chunk_size=5, n_action_steps=5).observation_deltas is None


@pytest.mark.parametrize("name", ["n_obs_steps", "chunk_size", "n_action_steps"])
def test_counts_start_at_one(name):
    counts = {"n_obs_steps": 1, "chunk_size": 5, "n_action_steps": 5, name: 0}
    with pytest.raises(ConfigurationError, match=f"{name}=0 must be at least 1"):
        ChunkTiming(**counts)


def test_only_predicted_actions_can_be_executed():
    with pytest.raises(ConfigurationError, match="n_action_steps=6 exceeds chunk_size=5"):
        ChunkTiming(n_obs_steps=1, chunk_size=5, n_action_steps=6)


def test_a_chunk_must_fit_the_longest_episode():
    timing = ChunkTiming(n_obs_steps=1, chunk_size=5, n_action_steps=5)
    timing.check_episode_length(5)
    with pytest.raises(
        ConfigurationError, match=r"chunk_size=5 .* longest episode \(4 steps\).*to 4 or less"
    ):
        timing.check_episode_length(4)
