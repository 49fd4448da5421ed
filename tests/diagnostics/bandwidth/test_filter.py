"""The closed form against reference values, identities and an O(T^2) simulation."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_act_chunking.diagnostics.bandwidth.filter import (
    chunk_weights,
    ensemble_filter,
    newest_chunk_filter,
    settle_steps,
    start_up_step,
)

FPS = 50
TIME_CONSTANT = 1 - math.exp(-1)


@pytest.mark.parametrize(
    ("chunk_size", "weighting", "coeff", "hertz", "delay", "n63", "n90", "n100", "samples"),
    [
        (10, "uniform", 0.0, 2.22, 4.5, 6, 8, 9, 10.0),
        (20, "uniform", 0.0, 1.11, 9.5, 12, 17, 19, 20.0),
        (20, "act", 0.1, 1.25, 12.62, 16, 19, 19, 15.2),
        (20, "recency", 0.1, 1.25, 6.38, 7, 15, 19, 15.2),
        (50, "uniform", 0.0, 0.443, 24.5, 31, 44, 49, 50.0),
        (100, "uniform", 0.0, 0.221, 49.5, 63, 89, 99, 100.0),
        (100, "act", 0.01, 0.228, 57.70, 73, 93, 99, 92.4),
        (100, "recency", 0.01, 0.228, 41.30, 51, 84, 99, 92.4),
        (100, "recency", 0.1, 0.797, 9.50, 9, 23, 99, 20.0),
    ],
)
def test_reference_values_at_50_hz(chunk_size, weighting, coeff, hertz, delay, n63, n90, n100, samples):
    kernel = ensemble_filter(chunk_size, 1, weighting, coeff, 0)
    assert kernel.bandwidth * FPS == pytest.approx(hertz, abs=0.006 if hertz > 1 else 0.0006)
    assert kernel.group_delay == pytest.approx(delay, abs=0.006)
    assert settle_steps(kernel.step(0), TIME_CONSTANT) == n63
    assert settle_steps(kernel.step(0), 0.9) == n90
    assert kernel.full_response(0) == kernel.last_age == n100
    assert kernel.effective_samples == pytest.approx(samples, abs=0.06)


@pytest.mark.parametrize("latency", [0, 3])
@pytest.mark.parametrize(("weighting", "sign"), [("act", 1), ("recency", -1)])
def test_is_the_published_transfer_function(weighting, sign, latency):
    chunk_size, coeff = 20, 0.1
    rho = math.exp(sign * coeff)
    frequency = np.array([0.0, 0.013, 0.1, 0.31, 0.5])
    z = np.exp(2j * np.pi * frequency)
    published = (
        (1 - rho)
        / (rho**latency - rho**chunk_size)
        * (rho / z) ** latency
        * (1 - (rho / z) ** (chunk_size - latency))
        / (1 - rho / z)
    )
    kernel = ensemble_filter(chunk_size, 1, weighting, coeff, latency)
    np.testing.assert_allclose(kernel.response(frequency), published, atol=1e-13)


def test_uniform_weights_are_a_moving_average():
    chunk_size, frequency = 25, np.array([0.003, 0.04, 0.11, 0.4])
    gain = np.abs(ensemble_filter(chunk_size, 1, "uniform", 0.0, 0).response(frequency))
    expected = np.abs(np.sin(np.pi * frequency * chunk_size) / (chunk_size * np.sin(np.pi * frequency)))
    np.testing.assert_allclose(gain, expected, atol=1e-13)
    assert gain[1] == pytest.approx(0, abs=1e-13)  # the first null is at 1/K


def test_recency_that_fades_within_a_chunk_is_a_first_order_low_pass():
    coeff = 0.05
    kernel = ensemble_filter(1000, 1, "recency", coeff, 0)
    assert kernel.bandwidth == pytest.approx(coeff / (2 * np.pi), rel=0.02)


settings = st.integers(1, 30).flatmap(
    lambda interval: st.tuples(
        st.just(interval), st.integers(0, 9), st.integers(0, 60), st.sampled_from([0.0, 0.01, 0.3, 10.0])
    )
)


@given(settings)
def test_act_and_recency_are_mirror_images(case):
    interval, latency, overlap, coeff = case
    chunk_size = interval + latency + overlap
    act, recency = (ensemble_filter(chunk_size, interval, w, coeff, latency) for w in ("act", "recency"))
    np.testing.assert_allclose(act.impulse[latency:], recency.impulse[latency:][::-1], atol=1e-15)
    frequency = np.linspace(0, 0.5, 23)
    np.testing.assert_allclose(
        np.abs(act.response(frequency)), np.abs(recency.response(frequency)), atol=1e-12
    )
    assert act.group_delay + recency.group_delay == pytest.approx(chunk_size - 1 + latency)


@given(settings, st.sampled_from(["act", "recency", "uniform"]))
def test_weights_sum_to_one_in_every_phase(case, weighting):
    interval, latency, overlap, coeff = case
    kernel = ensemble_filter(interval + latency + overlap, interval, weighting, coeff, latency)
    assert kernel.impulse.sum() == pytest.approx(1)
    assert not kernel.impulse[:latency].any()
    for phase in range(interval):
        ages, weights = kernel.phase_weights(phase)
        assert weights.sum() == pytest.approx(1)
        assert (ages % interval == phase).all()
        assert ages.min() >= latency


@pytest.mark.parametrize("interval", [1, 2, 5, 10, 25, 50])
def test_uniform_weights_have_the_same_mean_response_however_often_they_replan(interval):
    np.testing.assert_allclose(ensemble_filter(50, interval, "uniform", 0.0, 0).impulse, 1 / 50, atol=1e-16)
    np.testing.assert_allclose(newest_chunk_filter(50, 0).impulse, 1 / 50)


@pytest.mark.parametrize(("interval", "delay"), [(1, 9.5), (10, 10.3), (50, 24.8), (100, 49.5)])
def test_replanning_rarely_delays_recency_weights(interval, delay):
    assert ensemble_filter(100, interval, "recency", 0.1, 0).group_delay == pytest.approx(delay, abs=0.05)


def brute_force_step(chunk_size, interval, latency, weight, event):
    """Share of chunks from ``event`` on in the weighted mean, step by step, from a reset on."""
    shares = []
    for now in range(event, event + chunk_size + interval):
        used = [s for s in range(0, now + 1, interval) if latency <= now - s < chunk_size] or [0]
        weights = np.array([weight(s, now) for s in used])
        shares.append(weights[np.array(used) >= event].sum() / weights.sum())
    return np.array(shares)


@given(settings, st.sampled_from(["act", "recency", "uniform"]), st.integers(0, 29))
def test_step_responses_in_every_phase_are_those_of_a_simulation(case, weighting, offset):
    interval, latency, overlap, coeff = case
    coeff = min(coeff, 0.3)  # the simulation's naive weights overflow beyond
    chunk_size = interval + latency + overlap
    sign = {"act": 1, "recency": -1, "uniform": 0}[weighting]
    event = 3 * chunk_size + offset % interval
    expected = brute_force_step(
        chunk_size, interval, latency, lambda s, now: math.exp(sign * coeff * (now - s)), event
    )
    kernel = ensemble_filter(chunk_size, interval, weighting, coeff, latency)
    wait = -event % interval
    shares = kernel.step(wait)
    shares = np.concatenate([shares, np.ones(len(expected))])[: len(expected)]
    np.testing.assert_allclose(shares, expected, atol=1e-12)
    full = kernel.full_response(wait)
    assert expected[full] == pytest.approx(1)
    assert full == 0 or expected[full - 1] < 1


@given(settings, st.sampled_from(["act", "recency", "uniform"]), st.integers(1, 80))
def test_start_up_is_that_of_a_simulation(case, weighting, event):
    interval, latency, overlap, coeff = case
    coeff = min(coeff, 0.3)
    chunk_size = interval + latency + overlap
    sign = {"act": 1, "recency": -1, "uniform": 0}[weighting]
    expected = brute_force_step(
        chunk_size, interval, latency, lambda s, now: math.exp(sign * coeff * (now - s)), event
    )[:chunk_size]
    kernel = ensemble_filter(chunk_size, interval, weighting, coeff, latency)
    np.testing.assert_allclose(start_up_step(kernel, weighting, coeff, event), expected, atol=1e-12)


def test_mean_step_is_the_mean_over_phases():
    kernel = ensemble_filter(23, 5, "recency", 0.07, 2)
    by_phase = [np.append(kernel.step(wait), np.ones(9))[:23] for wait in range(5)]
    np.testing.assert_allclose(kernel.mean_step(), np.mean(by_phase, axis=0), atol=1e-14)


def test_newest_chunk_is_dead_time():
    kernel = newest_chunk_filter(4, 3)
    np.testing.assert_allclose(kernel.impulse, [0, 0, 0, 0.25, 0.25, 0.25, 0.25])
    np.testing.assert_allclose(kernel.step(0)[:4], [0, 0, 0, 1])
    np.testing.assert_allclose(kernel.step(2)[:6], [0, 0, 0, 0, 0, 1])
    assert (kernel.full_response(0), kernel.full_response(3)) == (3, 6)


def test_cross_fade_rises_in_equal_steps():
    np.testing.assert_allclose(newest_chunk_filter(7, 1, 3).step(0)[:6], [0, 0.25, 0.5, 0.75, 1, 1])
    assert newest_chunk_filter(7, 1, 3).full_response(0) == 4


@pytest.mark.parametrize("interval", [1, 30, 500])
@pytest.mark.parametrize("coeff", [0.0, 1e-9, 10.0])
@pytest.mark.parametrize("weighting", ["act", "recency"])
def test_extremes_stay_finite(weighting, coeff, interval):
    kernel = ensemble_filter(1000, interval, weighting, coeff, 2)
    assert np.isfinite(kernel.impulse).all()
    assert np.isfinite(kernel.group_delay)
    assert kernel.bandwidth is None or 0 < kernel.bandwidth <= 0.5


def test_single_actions_have_no_bandwidth_limit():
    assert ensemble_filter(1, 1, "act", 0.01, 0).bandwidth is None
    assert newest_chunk_filter(1, 5).bandwidth is None  # a pure delay


def test_two_equal_weights_lose_half_their_power_at_a_quarter():
    assert ensemble_filter(2, 1, "uniform", 0.0, 0).bandwidth == pytest.approx(0.25, abs=1e-12)


def test_act_weighs_the_oldest_most():
    np.testing.assert_allclose(chunk_weights(3, "act", math.log(2)), np.array([1, 2, 4]) / 7)
    np.testing.assert_allclose(chunk_weights(3, "recency", math.log(2)), np.array([4, 2, 1]) / 7)


def test_settling_means_staying():
    shares = np.array([0.0, 0.95, 0.8, 0.9, 1.0])
    assert settle_steps(shares, 0.9) == 3
    assert settle_steps(shares, 1.5) == 5
    assert settle_steps(np.full(10, 0.1).cumsum(), 0.9) == 8  # 0.9 but for rounding
