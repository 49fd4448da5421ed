import numpy as np
import pytest

from lerobot_act_chunking.envs.demonstration import minimum_jerk
from lerobot_act_chunking.envs.strokes import Stroke, blend, script_times, shift_free


def test_minimum_jerk_values_worked_out_by_hand():
    phases = np.array([-1.0, 0.0, 0.25, 0.5, 1.0, 2.0])
    # 0.25^3 (10 - 15/4 + 6/16) = 6.625 / 64
    np.testing.assert_allclose(minimum_jerk(phases), [0, 0, 6.625 / 64, 0.5, 1, 1])


def test_blend_visits_each_target_in_turn():
    strokes = (Stroke(0.0, 1.0, (2.0, 1.0)), Stroke(1.0, 3.0, (2.0, -1.0)))
    path = blend(np.array([0.0, 0.5, 1.0, 2.0, 3.0]), (0.0, 5.0), strokes)
    np.testing.assert_allclose(path, [[0, 5], [1, 3], [2, 1], [2, 0], [2, -1]])


def test_overlapping_strokes_add_up_without_stopping():
    times = np.linspace(0.0, 2.0, 101)
    path = blend(times, (0.0,), (Stroke(0.0, 1.2, (1.0,)), Stroke(0.8, 2.0, (2.0,))))[:, 0]
    middle = np.diff(path)[25:75]
    assert path[-1] == pytest.approx(2.0)
    assert middle.min() > 0.25 * middle.max()


def test_a_stroke_that_began_earlier_starts_in_motion():
    path = blend(np.array([0.0, 0.02]), (0.0,), (Stroke(-0.25, 1.0, (1.0,)),))[:, 0]
    assert 0 < path[0] < 0.1
    assert path[1] - path[0] > 0.01


def test_waypoint_noise_moves_free_positions_only():
    fixed, free = Stroke(0, 1, (1.0, 2.0, 3.0, 0.4, 0.5)), Stroke(1, 2, (1.0, 2.0, 3.0, 0.4, 0.5), free=True)
    kept, moved = shift_free((fixed, free), 0.01, np.random.default_rng(0))
    assert kept == fixed
    assert (moved.start, moved.end, moved.target[3:]) == (1, 2, (0.4, 0.5))
    assert np.all(np.abs(np.subtract(moved.target[:3], free.target[:3])) > 0)


def test_steps_fall_every_period_at_any_speed():
    np.testing.assert_allclose(
        script_times((0.0, 1.0), (), 1.0, period=0.02), np.arange(51) * 0.02, atol=1e-9
    )
    np.testing.assert_allclose(
        script_times((0.0, 1.0), (), 0.8, period=0.02), np.arange(63) * 0.016, atol=1e-9
    )


def test_a_dwell_lingers_around_its_pause_and_nowhere_else():
    times = script_times((0.0, 1.0), [(0.5, 0.4)], 1.0, period=0.02)
    steps = np.diff(times)
    lingering = steps < 0.01
    assert len(times) == 71
    assert np.all(steps > 0)
    assert np.all(np.abs(times[:-1][lingering] - 0.5) < 0.06)
    np.testing.assert_allclose(steps[times[1:] < 0.44], 0.02, atol=1e-9)


def test_without_a_window_a_dwell_stands_still():
    times = script_times((0.0, 1.0), [(0.5, 0.4)], 1.0, period=0.02, window=0.0)
    assert len(times) == 71
    assert np.sum(np.abs(times - 0.5) < 0.006) == 21
    moving = np.diff(times)[np.abs(times[:-1] - 0.5) > 0.03]
    np.testing.assert_allclose(moving, 0.02, atol=1e-9)
