import itertools

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


@pytest.mark.parametrize(
    ("size", "stride", "episode", "taught"),
    [(5, 1, 5, 5), (5, 1, 9, 5), (5, 1, 3, 3), (5, 1, 1, 1), (4, 5, 16, 16), (4, 5, 15, 6), (4, 5, 10, 1)],
)
def test_steps_that_episodes_teach(size, stride, episode, taught):
    assert ChunkTiming(1, size, stride).taught_steps(episode) == taught


def test_taught_steps_are_all_that_no_padding_decides():
    for size, stride, episode in itertools.product(range(2, 6), range(1, 5), range(1, 22)):
        timing = ChunkTiming(n_obs_steps=1, chunk_size=size, chunk_stride=stride)
        decided = [
            n
            for n in range(1, timing.control_steps + 1)
            if (timing.predictions_for(n) - 1) * stride < episode
        ]
        taught = timing.taught_steps(episode)
        assert taught == max([1, *decided]), (size, stride, episode)
        assert taught <= episode


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
