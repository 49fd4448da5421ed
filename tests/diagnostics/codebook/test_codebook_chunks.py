"""Chunks of demonstrations, coded in the tokenizer's own units."""

import numpy as np
import pytest
import torch
from codebook_fakes import FPS, MEAN, STD, STRIDE, TIMING, C, coder, episodes
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.factory import make_pre_post_processors

from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.diagnostics.codebook.chunks import cut_chunks
from lerobot_act_chunking.diagnostics.codebook.scale import ActionScale
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.policies.loading import LoadedPolicy


def counting(lengths=(12, 5, 9)):
    """Actions that say their episode and step."""
    made = {10 + e: np.stack([np.full(n, 10 + e), np.arange(n)], axis=1) for e, n in enumerate(lengths)}
    return ActionEpisodes(
        "data", FPS, ("episode", "step"), {e: rows.astype(np.float32) for e, rows in made.items()}
    )


def test_a_chunk_from_every_step_held_at_the_episodes_end():
    chunks = cut_chunks(counting(), TIMING)
    first = chunks.episode == 10
    assert chunks.step[first].tolist() == list(
        range(12 - STRIDE)
    )  # the second of four must be in the episode
    assert set(chunks.episode) == {10, 11, 12}
    steps = chunks.step[:, None] + STRIDE * np.arange(C)
    lengths = np.array([{10: 12, 11: 5, 12: 9}[e] for e in chunks.episode])[:, None]
    np.testing.assert_array_equal(chunks.is_pad, steps >= lengths)
    np.testing.assert_array_equal(chunks.actions[..., 1], np.minimum(steps, lengths - 1))
    np.testing.assert_array_equal(chunks.actions[..., 0], chunks.episode[:, None] + 0 * steps)
    np.testing.assert_allclose(chunks.progress, chunks.step / (lengths[:, 0] - 1))
    assert chunks.is_pad.mean(1).max() == 0.5
    assert chunks.control_steps == 10


def test_too_many_chunks_are_thinned_out_evenly():
    everything = cut_chunks(counting((101,)), TIMING)
    some = cut_chunks(counting((101,)), TIMING, most=8)
    assert len(everything) == 98
    assert some.step.tolist() == np.linspace(0, 97, 8).round().tolist()


def test_episodes_must_be_half_as_long_as_a_chunk():
    with pytest.raises(DatasetError, match="half as long as a chunk of 40 control steps: choose a shorter"):
        cut_chunks(counting((12, 15)), ChunkTiming(1, 40))


def test_only_some_episodes():
    assert list(counting().only([12, 10, 99]).episodes) == [12, 10]


def test_codes_and_errors_in_the_tokenizers_own_units():
    chunks = cut_chunks(episodes(), TIMING)
    coded = coder().code(chunks)
    normalised = (chunks.actions - MEAN) / STD
    told = np.clip(normalised[:, 0, 0] + 4, 0, 7.99)
    np.testing.assert_array_equal(coded.codes[:, 0], np.floor(told))
    np.testing.assert_array_equal(coded.codes[:, 1], np.floor(told % 1 * 8))
    expected = coded.codes[:, 0] + (coded.codes[:, 1] + 0.5) / 8 - 4
    np.testing.assert_allclose(coded.decoded[:, 2, 0], MEAN[0] + STD[0] * expected, rtol=1e-5)
    np.testing.assert_allclose(coded.decoded[..., 1], MEAN[1], rtol=1e-6)
    errors = np.where(chunks.is_pad[..., None], np.nan, np.abs(coded.decoded - chunks.actions))
    np.testing.assert_allclose(coded.errors, errors, rtol=1e-5)
    np.testing.assert_allclose(coded.lost, np.nanmean((errors / STD) ** 2, axis=1), rtol=1e-3)
    np.testing.assert_allclose(coded.chunk_errors, np.sqrt(coded.lost.mean(1)))
    np.testing.assert_allclose(coded.varies, normalised[~chunks.is_pad].var(0), rtol=1e-4)
    assert coded.lost_variance[1] == pytest.approx(1, abs=0.1)


def test_blocks_do_not_change_codes(monkeypatch):
    chunks = cut_chunks(episodes(), TIMING)
    whole = coder().code(chunks)
    monkeypatch.setattr("lerobot_act_chunking.diagnostics.codebook.coding.CHUNKS_AT_ONCE", 7)
    parts = coder().code(chunks)
    np.testing.assert_array_equal(parts.codes, whole.codes)
    np.testing.assert_array_equal(parts.decoded, whole.decoded)


def test_a_dimension_that_is_held_still_has_no_share_to_lose():
    coded = coder().code(cut_chunks(episodes(still=True), TIMING))
    assert np.isnan(coded.lost_variance[1])
    assert coded.lost_variance[0] > 0


def test_the_scale_is_that_of_the_checkpoints_processors():
    config = ACTConfig(
        input_features={"observation.state": PolicyFeature(FeatureType.STATE, (3,))},
        output_features={"action": PolicyFeature(FeatureType.ACTION, (2,))},
        device="cpu",
        push_to_hub=False,
    )
    stats = {
        "observation.state": {"mean": torch.zeros(3), "std": torch.ones(3)},
        "action": {"mean": torch.tensor(MEAN), "std": torch.tensor(STD)},
    }
    loaded = LoadedPolicy(None, *make_pre_post_processors(config, dataset_stats=stats))
    actions = np.random.default_rng(0).normal(size=(3, 5, 2)).astype(np.float32)
    found = ActionScale.of_policy(loaded)
    np.testing.assert_allclose(found.normalised(actions), (actions - MEAN) / STD, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(found.raw(found.normalised(actions)), actions, rtol=1e-4, atol=1e-5)


def test_bounds_become_one():
    bounds = {"min": [-3.0, 0.0], "max": [1.0, 0.5]}
    found = ActionScale.of_statistics(NormalizationMode.MIN_MAX, bounds, 2)
    np.testing.assert_allclose(found.normalised(np.array([[-3.0, 0.25], [1.0, 0.5]])), [[-1, 0], [1, 1]])
