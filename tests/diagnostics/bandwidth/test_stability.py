"""The loop gain limit against polynomial roots and against simulation."""

import numpy as np
import pytest

from lerobot_act_chunking.diagnostics.bandwidth.filter import ensemble_filter, newest_chunk_filter
from lerobot_act_chunking.diagnostics.bandwidth.stability import gain_limit


@pytest.mark.parametrize(
    ("chunk_size", "weighting", "coeff", "expected"),
    [
        (1, "uniform", 0.0, 2.0),
        (10, "uniform", 0.0, 0.489),
        (50, "uniform", 0.0, 0.0987),
        (100, "uniform", 0.0, 0.0493),
        (100, "act", 0.01, 0.0355),
        (100, "recency", 0.01, 0.0867),
        (100, "recency", 0.1, 40.03),
    ],
)
def test_reference_values(chunk_size, weighting, coeff, expected):
    kernel = ensemble_filter(chunk_size, 1, weighting, coeff, 0)
    assert gain_limit(kernel) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("chunk_size", [2, 16, 64, 1000])  # powers of two put the crossing on a grid point
def test_limit_of_uniform_weights_is_exact(chunk_size):
    exact = 2 * chunk_size * np.sin(np.pi / (2 * chunk_size)) ** 2  # about pi^2 / (2 K)
    assert gain_limit(ensemble_filter(chunk_size, 1, "uniform", 0.0, 0)) == pytest.approx(exact, rel=1e-9)


def spectral_radius(impulse, gain):
    polynomial = np.zeros(len(impulse) + 1)
    polynomial[:2] = 1, -1
    polynomial[1:] += gain * impulse
    return np.abs(np.roots(polynomial)).max()


@pytest.mark.parametrize("latency", [0, 4])
@pytest.mark.parametrize("weighting", ["act", "recency", "uniform"])
@pytest.mark.parametrize("coeff", [0.0, 0.02, 0.3])
def test_a_root_leaves_the_unit_circle_at_the_limit(weighting, coeff, latency):
    kernel = ensemble_filter(17, 1, weighting, coeff, latency)
    limit = gain_limit(kernel)
    assert spectral_radius(kernel.impulse, 0.999 * limit) < 1 < spectral_radius(kernel.impulse, 1.001 * limit)


def closed_loop_growth(kernel, gain, n_steps=4000):
    """Amplitude late in x(t+1) = x(t) - gain a(t), whose chunks are computed every R steps, over early."""
    x = [1.0]
    for now in range(n_steps):
        ages, weights = kernel.phase_weights(now % kernel.replan_interval)
        past = [x[now - age] if now >= age else 1.0 for age in ages]
        x.append(x[-1] - gain * float(weights @ past))
    return np.abs(x[-500:]).max()


@pytest.mark.parametrize(
    "kernel",
    [
        newest_chunk_filter(7, 0),
        newest_chunk_filter(5, 3),
        newest_chunk_filter(6, 1, 4),
        ensemble_filter(23, 5, "act", 0.05, 2),
        ensemble_filter(24, 8, "recency", 0.1, 0),
    ],
)
def test_rare_replanning_is_stable_up_to_the_limit(kernel):
    limit = gain_limit(kernel)
    assert closed_loop_growth(kernel, 0.97 * limit) < 0.2
    assert closed_loop_growth(kernel, 1.03 * limit) > 5


def test_open_loop_tolerates_two_per_chunk():
    assert gain_limit(newest_chunk_filter(50, 0)) == pytest.approx(2 / 50)
