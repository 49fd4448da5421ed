import pytest

from lerobot_act_chunking.data.timing import ChunkTiming, QueryTiming
from lerobot_act_chunking.errors import ConfigurationError


def test_steps_relative_to_now():
    timing = ChunkTiming(n_obs_steps=3, chunk_size=5)
    assert timing.observation_deltas == [-2, -1, 0]
    assert timing.action_deltas == [0, 1, 2, 3, 4]
    assert timing.control_steps == 5


def test_strided_observations_reach_further_back():
    timing = ChunkTiming(n_obs_steps=3, chunk_size=5, obs_stride=4)
    assert timing.observation_deltas == [-8, -4, 0]
    assert timing.action_deltas == [0, 1, 2, 3, 4]


def test_strided_predictions_reach_further():
    timing = ChunkTiming(n_obs_steps=1, chunk_size=4, chunk_stride=5)
    assert timing.action_deltas == [0, 5, 10, 15]
    assert timing.control_steps == 16


@pytest.mark.parametrize(
    ("n_steps", "predictions"), [(1, 2), (2, 3), (6, 3), (7, 4), (11, 4), (12, 4), (16, 4)]
)
def test_interpolation_looks_one_prediction_ahead(n_steps, predictions):
    assert ChunkTiming(n_obs_steps=1, chunk_size=4, chunk_stride=5).predictions_for(n_steps) == predictions


def test_without_stride_every_step_is_a_prediction():
    assert ChunkTiming(n_obs_steps=1, chunk_size=4).predictions_for(3) == 3


def test_one_observation_has_no_time_axis():
    assert ChunkTiming(n_obs_steps=1, chunk_size=5).observation_deltas is None


@pytest.mark.parametrize("name", ["n_obs_steps", "chunk_size", "chunk_stride", "obs_stride"])
def test_counts_start_at_one(name):
    counts = {"n_obs_steps": 1, "chunk_size": 5, "chunk_stride": 1, name: 0}
    with pytest.raises(ConfigurationError, match=f"{name}=0 must be at least 1"):
        ChunkTiming(**counts)


def test_a_single_prediction_cannot_be_strided():
    with pytest.raises(ConfigurationError, match="chunk_stride=2 needs a chunk_size of 2 or more"):
        ChunkTiming(n_obs_steps=1, chunk_size=1, chunk_stride=2)


def test_a_single_observation_cannot_be_strided():
    with pytest.raises(ConfigurationError, match="obs_stride=2 needs n_obs_steps of 2 or more"):
        ChunkTiming(n_obs_steps=1, chunk_size=5, obs_stride=2)


def test_a_chunk_must_fit_the_longest_episode():
    timing = ChunkTiming(n_obs_steps=1, chunk_size=5)
    timing.check_episode_length(5)
    with pytest.raises(
        ConfigurationError, match=r"chunk_size=5 .* longest episode \(4 steps\).*to 4 or less"
    ):
        timing.check_episode_length(4)
    with pytest.raises(ConfigurationError, match="to 3 or less"):
        ChunkTiming(n_obs_steps=1, chunk_size=4, chunk_stride=5).check_episode_length(15)


def test_queries_of_earlier_and_later_observations():
    queries = QueryTiming(ChunkTiming(n_obs_steps=3, chunk_size=4), n_action_pred_token=2)
    assert queries.n_queries == 4
    assert queries.steps == [-2, -1, 0, 1, 2, 3, 4]
    assert queries.windows == [[0, 1, 2, 3], [1, 2, 3, 4], [2, 3, 4, 5], [3, 4, 5, 6]]


def test_queries_load_only_what_they_predict():
    queries = QueryTiming(ChunkTiming(n_obs_steps=2, chunk_size=3, chunk_stride=5), n_action_pred_token=1)
    assert queries.steps == [-1, 0, 4, 5, 9, 10]
    assert queries.windows == [[0, 2, 4], [1, 3, 5]]


def test_a_single_query_is_the_current_chunk():
    timing = ChunkTiming(n_obs_steps=1, chunk_size=4, chunk_stride=5)
    queries = QueryTiming(timing, n_action_pred_token=1)
    assert (queries.steps, queries.windows) == (timing.action_deltas, [[0, 1, 2, 3]])
