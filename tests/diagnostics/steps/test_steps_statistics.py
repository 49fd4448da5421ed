"""The numbers behind the sweep, against closed forms."""

import numpy as np
import pytest
from scipy.stats import norm

from lerobot_act_chunking.diagnostics.steps.modes import find_all_modes, find_modes, silhouette
from lerobot_act_chunking.diagnostics.steps.statistics import (
    chunk_distances,
    chunk_error,
    energy_distance,
    observed_order,
    quantiles,
    spread,
)

T, P, C = 5, 2, 3


def chunks(values):
    """Chunks (N, T, P, C) whose points all sit at ``values`` (N,) on the first axis of the first point."""
    points = np.zeros((len(values), T, P, C))
    points[..., 0, 0] = np.asarray(values)[:, None]
    return points


def test_quantiles_leave_out_what_was_not_measured():
    found = quantiles(np.array([np.nan, 1.0, 2.0, 3.0]))
    assert found == {"p50": 2.0, "p95": pytest.approx(2.9), "max": 3.0, "count": 3}
    assert quantiles(np.array([np.nan])) is None


def test_a_chunk_is_as_far_off_as_its_worst_step():
    errors = np.array([[0.1, 0.5, 0.2], [0.3, 0.1, 0.2]])
    assert chunk_error(errors).tolist() == [0.5, 0.3]
    at = np.array([[True, False, True], [False, False, False]])
    np.testing.assert_array_equal(chunk_error(errors, at), [0.2, np.nan])
    np.testing.assert_array_equal(chunk_error(np.full((1, 3), np.nan), at[:1]), [np.nan])


def test_distances_of_chunks_are_rms_over_steps():
    one, other = np.zeros((1, T, P, C)), np.zeros((1, T, P, C))
    other[0, 0, 1] = [3.0, 0.0, 4.0]
    assert chunk_distances(one, other) == pytest.approx(5 / np.sqrt(T))


@pytest.mark.parametrize("shift", [0.0, 0.5, 2.0])
def test_energy_distance_of_two_gaussians(shift):
    noise = np.random.default_rng(0).normal(size=3000)
    found, largest = energy_distance(chunks(noise + shift), chunks(noise))
    sd = np.sqrt(2)
    apart = sd * np.sqrt(2 / np.pi) * np.exp(-(shift**2) / 4) + shift * (1 - 2 * norm.cdf(-shift / sd))
    assert found == pytest.approx(2 * apart - 4 / np.sqrt(np.pi), abs=0.02)
    assert largest == pytest.approx(2 * apart, rel=0.03)


def test_energy_distance_is_unbiased_for_equal_noises():
    rng = np.random.default_rng(1)
    found = [energy_distance(chunks(0.6 * noise), chunks(noise))[0] for noise in rng.normal(size=(2000, 8))]
    expected = 2 * np.sqrt(2 / np.pi) * (np.sqrt(1 + 0.36) - (0.6 + 1) / np.sqrt(2))
    assert np.mean(found) == pytest.approx(expected, abs=4 * np.std(found) / np.sqrt(len(found)))
    noise = rng.normal(size=16)
    assert energy_distance(chunks(noise), chunks(noise))[0] == pytest.approx(0, abs=1e-12)


def test_spread_is_of_the_point_that_spreads_most():
    samples = np.random.default_rng(2).normal(size=(20000, 2, P, C)) * [[0.1], [0.5]]  # per point
    np.testing.assert_allclose(spread(samples), 0.5 * np.sqrt(3), rtol=0.02)


def test_spread_within_modes_does_not_see_their_distance():
    rng = np.random.default_rng(3)
    labels = np.repeat([0, 2], 1000)
    samples = chunks(0.1 * rng.normal(size=2000) + 50 * labels)
    np.testing.assert_allclose(spread(samples, labels), 0.1, rtol=0.05)
    assert spread(samples).min() > 40


@pytest.mark.parametrize("order", [1, 2, 4])
def test_order_of_convergence(order):
    n = [1, 2, 3, 5, 8, 10, 16, 20]
    errors = [9.0, 9.0, 9.0, *(3.0 * k**-order for k in n[3:])]
    assert observed_order(n, errors, 0.0) == pytest.approx(order)
    assert observed_order(n[:5], errors[:5], 0.0) is None


def test_errors_near_the_references_own_say_nothing_about_the_order():
    n = [5, 8, 10, 16, 20, 32, 50]
    errors = [1 / k**2 + 1e-3 for k in n]
    assert observed_order(n, errors, 1e-3) == pytest.approx(1.9, abs=0.1)
    assert observed_order(n, errors, 0.0) < 1.8


def test_three_modes_and_their_masses():
    rng = np.random.default_rng(4)
    where = np.repeat([0.0, 7.0, -4.0], [5, 12, 3])
    modes = find_modes(chunks(where + 0.1 * rng.normal(size=20)), tolerance=0.5)
    assert modes.count == 3
    np.testing.assert_allclose(modes.masses(), [0.6, 0.25, 0.15])
    assert modes.separation == pytest.approx(4.0, abs=0.3)
    np.testing.assert_allclose(modes.masses(chunks([6.8, 0.1, 6.9, 1.0])), [0.5, 0.5, 0.0])


def test_one_gaussian_is_one_mode():
    rng = np.random.default_rng(5)
    for shape in ((16, T, P, C), (16, 1, 1, 2)):
        assert all(find_modes(rng.normal(size=shape), 0.01).count == 1 for _ in range(50))
    line = [chunks(rng.normal(size=16)) for _ in range(100)]
    assert np.mean([find_modes(each, 0.01).count > 1 for each in line]) < 0.08  # clumps by chance
    assert {modes.count for modes in find_all_modes(line, 0.01)} == {1}


def test_modes_that_enough_observations_have_are_believed():
    two, one = chunks(np.repeat([0.0, 9.0], 8)), chunks(np.zeros(16))
    assert [modes.count for modes in find_all_modes([one] * 9 + [two], 0.5)] == [1] * 9 + [2]
    assert [modes.count for modes in find_all_modes([one] * 11 + [two], 0.5)] == [1] * 12


def test_modes_within_the_tolerance_and_single_outliers_are_none():
    rng = np.random.default_rng(6)
    two = chunks(np.repeat([0.0, 0.4], 8) + 0.01 * rng.normal(size=16))
    assert find_modes(two, tolerance=0.5).count == 1
    assert find_modes(two, tolerance=0.3).count == 2
    outlier = chunks([*(0.1 * rng.normal(size=15)), 9.0])
    assert find_modes(outlier, tolerance=0.5).count == 1
    assert find_modes(chunks(np.zeros(16)), tolerance=0.5).count == 1


def test_silhouette_of_a_small_example():
    apart = np.abs(np.subtract.outer([0.0, 1.0, 10.0, 12.0], [0.0, 1.0, 10.0, 12.0]))
    expected = np.mean([1 - 1 / 11, 1 - 1 / 10, 1 - 2 / 9.5, 1 - 2 / 11.5])
    assert silhouette(apart, np.array([0, 0, 1, 1])) == pytest.approx(expected)


def test_the_spread_of_few_samples_is_unbiased():
    """Two samples at -1 and 1 come from a variance of 2, as the mean of many such pairs has it."""
    pair = np.array([-1.0, 1.0]).reshape(2, 1, 1, 1)
    assert spread(pair)[0] == pytest.approx(np.sqrt(2))
    modes = np.concatenate((pair, pair + 50))
    assert spread(modes, np.array([0, 0, 1, 1]))[0] == pytest.approx(np.sqrt(2))
