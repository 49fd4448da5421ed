"""Chunk boundaries and disagreement on motions whose answers are known."""

import numpy as np
import pytest

from lerobot_act_chunking.diagnostics.core.rollouts import Inference, Rollout
from lerobot_act_chunking.diagnostics.core.trajectories import UndefinedMeasureError
from lerobot_act_chunking.diagnostics.smoothness.chunks import (
    boundary_profile,
    boundary_ratio,
    boundary_steps,
    boundary_to_plan_ratio,
    disagreement,
)

A, CHUNK = 4, 12
SCALE = np.array([1.0, 2.0, 0.5, 4.0])


def a_rollout(commands: np.ndarray, inferences: tuple[Inference, ...] = ()) -> Rollout:
    return Rollout(7, 0.02, commands, commands, np.zeros(len(commands)), False, inferences)


def ramp(steps: int) -> np.ndarray:
    """Constant velocity of length 1 per step."""
    return np.arange(steps)[:, None] * np.full(A, 0.5)


def jumps(steps: int, at: np.ndarray, size: float) -> np.ndarray:
    """A ramp whose step into each ``at`` is ``size`` times the others."""
    sizes = np.ones(steps)
    sizes[at] = size
    return np.cumsum(sizes)[:, None] * np.full(A, 0.5)


def planned(steps: int, every: int, plan=lambda step: ramp(CHUNK)) -> tuple[Inference, ...]:
    return tuple(Inference(step, plan(step)) for step in range(0, steps, every))


def test_a_chunk_begins_where_it_was_inferred_or_later_by_the_latency():
    rollout = a_rollout(ramp(40), planned(40, 10))
    np.testing.assert_array_equal(boundary_steps(rollout), [10, 20, 30])
    np.testing.assert_array_equal(boundary_steps(rollout, latency_steps=3), [13, 23, 33])
    np.testing.assert_array_equal(boundary_steps(rollout, latency_steps=10), [20, 30])
    assert boundary_steps(a_rollout(ramp(40))).size == 0


def test_a_seamless_motion_has_ratio_one_and_jumps_show_at_their_size():
    at = np.array([10, 20, 30])
    assert boundary_ratio([ramp(40)], [at]) == pytest.approx(1.0)
    assert boundary_ratio([jumps(40, at, 3.0)], [at]) == pytest.approx(3.0)
    assert boundary_ratio([jumps(40, at, 0.25)], [at]) == pytest.approx(0.25)
    # The jump is at the boundary and not beside it.
    assert boundary_ratio([jumps(40, at + 1, 3.0)], [at]) == pytest.approx(1.0)
    assert boundary_ratio([jumps(40, at - 1, 3.0)], [at]) == pytest.approx(1.0)


def test_episodes_are_pooled():
    at = np.array([10, 20, 30])
    calm, rough = ramp(40), jumps(40, at, 5.0)
    assert boundary_ratio([calm, rough, rough], [at, at, at]) == pytest.approx(5.0)
    assert boundary_ratio([calm, calm, rough], [at, at, at]) == pytest.approx(1.0)


def test_accelerations_at_boundaries_against_those_of_a_steady_curve():
    t = np.arange(60.0)
    curve = 0.5 * t[:, None] ** 2 * np.full(A, 0.5)  # acceleration of length 1
    at = np.array([15, 30, 45])
    assert boundary_ratio([curve], [at], order=2) == pytest.approx(1.0)
    stepped = curve + 6.0 * (t[:, None] >= at).sum(1)[:, None] * np.full(A, 0.5)
    assert boundary_ratio([stepped], [at], order=2) == pytest.approx(7.0)


def test_ratios_that_mean_nothing_are_undefined():
    every = np.arange(1, 40)
    with pytest.raises(UndefinedMeasureError, match="almost every step leaves too little to compare"):
        boundary_ratio([ramp(40)], [every])
    with pytest.raises(UndefinedMeasureError, match="almost every step leaves too little to compare"):
        boundary_ratio([ramp(40)], [every + 1])  # as achieved: one step later, one step of "elsewhere"
    with pytest.raises(UndefinedMeasureError, match="no chunk boundary"):
        boundary_ratio([ramp(40)], [np.array([], int)])
    with pytest.raises(UndefinedMeasureError, match="nothing moves most of the time"):
        boundary_ratio([np.zeros((40, A))], [np.array([10])])


def test_a_step_into_a_chunk_against_the_step_it_plans_next():
    at = np.arange(5, 40, 5)
    twice = a_rollout(jumps(40, at, 2.0), planned(40, 5))
    assert boundary_to_plan_ratio([twice], [0, 1], SCALE) == pytest.approx(2.0)
    every_step = a_rollout(ramp(40), planned(40, 1, lambda step: 0.5 * ramp(CHUNK)))
    assert boundary_to_plan_ratio([every_step], range(A), SCALE) == pytest.approx(2.0)


def test_the_planned_step_is_taken_where_the_chunk_is_first_used():
    def bent(step):
        """Plans steps of 1 up to the fourth action, of 4 from there on."""
        return jumps(CHUNK, np.arange(4, CHUNK), 4.0)

    rollout = a_rollout(ramp(40), planned(40, 8, bent))
    assert boundary_to_plan_ratio([rollout], range(A), SCALE, latency_steps=2) == pytest.approx(1.0)
    assert boundary_to_plan_ratio([rollout], range(A), SCALE, latency_steps=3) == pytest.approx(0.25)


def test_plans_in_other_dimensions_and_units_do_not_mix():
    def sideways(step):
        return np.arange(CHUNK)[:, None] * np.array([0.5, 9.0, 9.0, 9.0])

    rollout = a_rollout(ramp(40), planned(40, 5, sideways))
    assert boundary_to_plan_ratio([rollout], [0], SCALE) == pytest.approx(1.0)
    assert boundary_to_plan_ratio([rollout], [0, 3], SCALE) == pytest.approx(
        np.hypot(0.5, 0.125) / np.hypot(0.5, 2.25)
    )
    with pytest.raises(UndefinedMeasureError, match="no chunk boundary with a logged chunk"):
        boundary_to_plan_ratio([a_rollout(ramp(40))], [0], SCALE)


def test_the_profile_peaks_at_the_boundary():
    at = np.array([15, 35, 55])
    profile = boundary_profile([jumps(80, at, 3.0)], [at])
    assert profile.shape == (21,)
    assert profile[10] == pytest.approx(3.0)
    np.testing.assert_allclose(np.delete(profile, 10), 1.0)
    with pytest.raises(UndefinedMeasureError, match="follow each other too closely"):
        boundary_profile([ramp(80)], [np.arange(1, 80, 5)])
    with pytest.raises(UndefinedMeasureError, match="no chunk boundary well inside"):
        boundary_profile([ramp(80)], [np.array([3, 77])])


def drifting(step):
    """Chunks that agree on everything but an offset, which grows with the step they were made at."""
    return (step + np.arange(CHUNK))[:, None] * np.ones(A) + 0.3 * step * np.array([1.0, 2.0, 0.5, 0.0])


def test_disagreement_grows_as_chunks_drift_apart():
    found = disagreement([a_rollout(ramp(30), planned(30, 3, drifting))], SCALE)
    np.testing.assert_array_equal(found.ages, [3, 6, 9])
    np.testing.assert_array_equal(found.pairs, [9, 8, 7])
    np.testing.assert_allclose(np.sqrt(found.mean_squares), 0.3 * found.ages[:, None] * [1, 1, 1, 0])
    np.testing.assert_allclose(found.rms([0, 1]), 0.3 * found.ages)
    np.testing.assert_allclose(found.rms([0, 3]), 0.3 * found.ages / np.sqrt(2))


def test_agreeing_chunks_do_not_disagree_whatever_they_plan():
    path = np.random.default_rng(2).normal(size=(60, A))
    chunks = planned(40, 1, lambda step: path[step : step + CHUNK])
    found = disagreement([a_rollout(path[:40], chunks)], SCALE)
    np.testing.assert_array_equal(found.ages, np.arange(1, CHUNK))
    np.testing.assert_array_equal(found.rms(range(A)), 0)
    assert found.pairs.max() == 32


def test_irregular_inferences_are_paired_by_their_age():
    steps = (0, 4, 5, 11)
    rollout = a_rollout(ramp(30), tuple(Inference(step, drifting(step)) for step in steps))
    found = disagreement([rollout], SCALE)
    np.testing.assert_array_equal(found.ages, [1, 4, 5, 6, 7, 11])
    np.testing.assert_array_equal(found.pairs, [1, 1, 1, 1, 1, 1])
    np.testing.assert_allclose(found.rms([0]), 0.3 * found.ages)


def test_many_ages_are_thinned_evenly():
    chunks = planned(99, 1, lambda step: (step + np.arange(90.0))[:, None] * np.ones(A))
    ages = disagreement([a_rollout(ramp(99), chunks)], SCALE).ages
    assert (len(ages), ages[0], ages[-1]) == (24, 1, 89)
    assert set(np.diff(ages)) == {3, 4, 5} or set(np.diff(ages)) == {3, 4}


def test_chunks_that_do_not_overlap_cannot_disagree():
    with pytest.raises(UndefinedMeasureError, match="chunks never overlap"):
        disagreement([a_rollout(ramp(40), planned(40, CHUNK))], SCALE)
    for inferences in ((), planned(5, 9), planned(40, 5, lambda step: np.empty((0, A)))):
        with pytest.raises(UndefinedMeasureError, match="fewer than two chunks were logged"):
            disagreement([a_rollout(ramp(40), inferences)], SCALE)
