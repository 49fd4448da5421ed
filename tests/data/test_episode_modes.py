"""Which way a demonstration goes: as recorded, or by clusters; and what its samples then weigh."""

import json

import numpy as np
import pytest

from lerobot_act_chunking.data.episode_modes import (
    clustered_modes,
    mode_weights,
    recorded_modes,
    require_recorded_modes,
)
from lerobot_act_chunking.errors import DatasetError


def write(folder, episodes):
    (folder / "meta").mkdir()
    (folder / "meta/recording.json").write_text(json.dumps({"episodes": episodes}))
    return folder


def episode(index, **details):
    return {"episode_index": index, "details": details}


def motions(counts, rng, noise=0.02):
    """Ways to the corners of a polygon, of slightly different lengths, in mixed order."""
    angles = 2 * np.pi * np.repeat(np.arange(len(counts)), counts) / len(counts)
    order = rng.permutation(len(angles))
    paths = [
        np.linspace(0, 1, rng.integers(18, 26))[:, None] * [np.cos(angle), np.sin(angle)]
        for angle in angles[order]
    ]
    labels = np.repeat(np.arange(len(counts)), counts)[order]
    return [each + noise * rng.normal(size=each.shape) for each in paths], labels


def test_modes_are_what_the_recording_says(tmp_path):
    folder = write(tmp_path, [episode(0, mode=2), episode(1, mode=0), episode(2)])
    assert recorded_modes(folder) == {0: 2, 1: 0}


def test_nothing_is_known_without_a_recording_and_that_is_refused_where_it_is_needed(tmp_path):
    assert recorded_modes(tmp_path) == {}
    with pytest.raises(DatasetError, match="balance_modes=clusters"):
        require_recorded_modes(tmp_path)


@pytest.mark.parametrize("episodes", ["none", [{"episode_index": 0}], [episode(0, mode="up")]])
def test_a_damaged_recording_is_named(tmp_path, episodes):
    with pytest.raises(DatasetError, match=r"recording\.json cannot be read"):
        recorded_modes(write(tmp_path, episodes))


def test_a_negative_mode_is_refused(tmp_path):
    with pytest.raises(DatasetError, match="negative"):
        recorded_modes(write(tmp_path, [episode(0, mode=-1)]))


@pytest.mark.parametrize("counts", [(40, 8, 2), (20, 20, 10), (30, 10), (12, 10, 8, 6)])
def test_clusters_are_the_ways_the_most_frequent_first(counts):
    found, labels = motions(counts, np.random.default_rng(0))
    np.testing.assert_array_equal(clustered_modes(found), labels)


def test_one_way_is_one_cluster_whatever_its_noise():
    for noise in (0.02, 0.3):
        found, _ = motions((50,), np.random.default_rng(1), noise)
        assert not clustered_modes(found).any()
    assert not clustered_modes([np.zeros((5, 2))] * 10).any()


def test_the_same_motions_give_the_same_clusters():
    found, _ = motions((30, 6, 4), np.random.default_rng(2))
    np.testing.assert_array_equal(clustered_modes(found), clustered_modes(found))


MODES = {0: 0, 1: 0, 2: 0, 3: 0, 4: 1}
LENGTHS = {0: 10, 1: 12, 2: 8, 3: 10, 4: 20}


def parts(power):
    """The part of each mode in a sum over all samples, and the mean weight."""
    weights = mode_weights(MODES, LENGTHS, power)
    sums = [sum(weights[each] * LENGTHS[each] for each in MODES if MODES[each] == mode) for mode in (0, 1)]
    return np.array(sums) / 60, weights


def test_with_power_one_all_modes_have_the_same_part():
    found, _ = parts(1.0)
    np.testing.assert_allclose(found, 0.5)


def test_with_power_zero_all_samples_weigh_the_same():
    _, weights = parts(0.0)
    assert set(weights.values()) == {1.0}


@pytest.mark.parametrize("power", [0.0, 0.3, 0.5, 1.0])
def test_the_mean_weight_is_one_and_the_ratio_is_a_power_of_the_shares(power):
    found, weights = parts(power)
    assert found.sum() == pytest.approx(1)
    assert weights[4] / weights[0] == pytest.approx((40 / 20) ** power)
