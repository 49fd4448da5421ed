"""What an exported policy draws, and for how long it keeps it."""

import numpy as np
import pytest

from act_chunking_runtime.draws import Draws, DrawSpec


def taken(spec, steps, seed=0):
    draws = Draws([spec], np.random.default_rng(seed))
    return [draws.take(step)[spec.name] for step in steps]


def test_new_numbers_for_every_chunk_or_kept_for_as_long_as_is_said():
    fresh = taken(DrawSpec("x", (1, 3), "normal"), (0, 5, 10))
    assert fresh[0].dtype == np.float32
    assert not np.array_equal(fresh[0], fresh[1])
    held = taken(DrawSpec("x", (1, 3), "normal", 10), (0, 5, 10))
    assert np.array_equal(held[0], held[1])
    assert not np.array_equal(held[1], held[2])
    episode = taken(DrawSpec("x", (1, 3), "normal", None), (0, 5, 1000))
    assert np.array_equal(episode[0], episode[2])


def test_a_new_episode_has_new_numbers():
    draws = Draws([DrawSpec("x", (1, 3), "normal", None)], np.random.default_rng(0))
    first = draws.take(0)["x"]
    draws.reset()
    assert not np.array_equal(draws.take(0)["x"], first)


def test_rows_stay_with_the_moment_that_they_were_drawn_for():
    spec = DrawSpec("x", (1, 4, 2), "normal", moment_steps=2)
    first, same, later, far = taken(spec, (0, 1, 4, 100))
    assert np.array_equal(first, same)
    assert np.array_equal(later[:, :2], first[:, 2:])
    assert not np.isin(far, later).any()


@pytest.mark.parametrize(("distribution", "low", "mean"), [("normal", -5, 0.0), ("uniform", 0, 0.5)])
def test_distributions(distribution, low, mean):
    (numbers,) = taken(DrawSpec("x", (10_000,), distribution), (0,))
    assert low <= numbers.min()
    assert numbers.mean() == pytest.approx(mean, abs=0.05)
