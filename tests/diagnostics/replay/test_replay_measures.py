"""Planted chunks and commands, whose errors, delays and rests are known."""

import numpy as np
import pytest

from lerobot_act_chunking.diagnostics.replay.execution import find_hesitations, switches, time_gripper
from lerobot_act_chunking.diagnostics.replay.horizon import (
    Chunks,
    by_person,
    measure_following,
    measure_horizon,
)

FPS, M, T = 10, 40, 6
ACTIONS = np.cumsum(np.random.default_rng(1).standard_normal((200, 2)), axis=0)
AT = np.arange(1, 1 + 3 * M, 3)
DONE = ACTIONS[AT[:, None] + np.arange(T)]
LAST = ACTIONS[AT - 1]


def chunks(predicted, nearest=None):
    still = np.repeat(LAST[:, None], T, axis=1)
    return Chunks(np.arange(M) // 10, predicted, DONE, still, LAST, nearest)


def follow(predicted, nearest=None):
    return measure_following(chunks(predicted, nearest), ACTIONS, [0, 1], FPS, np.random.default_rng(0))


def test_errors_are_in_the_datasets_units_by_step():
    off = DONE + np.array([3.0, 0.5]) * np.arange(T)[:, None]
    found = measure_horizon(chunks(off))
    assert found.median["policy"] == pytest.approx(np.array([3.0, 0.5]) * np.arange(T)[:, None])
    assert found.p90["policy"] == pytest.approx(found.median["policy"])
    assert set(found.median) == {"policy", "hold_still"}


def test_steps_after_the_end_do_not_count():
    short = DONE.copy()
    short[:, 4:] = np.nan
    found = measure_horizon(Chunks(np.zeros(M), DONE, short, DONE, LAST, None))
    assert found.median["policy"][:4] == pytest.approx(0)
    assert np.isnan(found.p90["policy"][4:]).all()


def test_who_does_what_was_done_follows():
    found = follow(DONE, DONE + 1.0)
    assert (found.errors["policy"], found.reduction) == (0.0, 1.0)
    assert found.correlation == pytest.approx(1.0)
    assert found.departure == found.departure_state == pytest.approx(1.0)
    assert found.against_nearest == (0.0, 0.0, 0.0)
    assert not found.outside.any()


def test_who_repeats_the_last_action_goes_nowhere():
    found = follow(np.repeat(LAST[:, None], T, axis=1))
    assert found.departure == found.reduction == found.correlation == 0
    assert found.variation > 0.8
    assert found.against_nearest is None


def test_who_always_does_the_same_has_no_variation():
    assert follow(np.full_like(DONE, 0.3)).variation == pytest.approx(0)


def test_other_units_are_outside():
    assert follow(57.3 * DONE + 1000).outside.min() == 1


def test_the_ratio_to_the_nearest_has_an_interval():
    noise = np.random.default_rng(2).standard_normal(DONE.shape)
    ratio, low, high = follow(DONE + 2 * noise, DONE + noise[::-1]).against_nearest
    assert low < ratio < high
    assert ratio == pytest.approx(2, rel=0.05)


def test_errors_of_each_person():
    off = DONE + (np.arange(M) // 10 >= 2)[:, None, None]
    people = by_person(chunks(off), {0: "ann", 1: "ann", 2: "bob"}, np.ones(2), [0, 1])
    assert {name: (each["episodes"], each["policy"]) for name, each in people.items()} == {
        "ann": (2, 0.0),
        "bob": (1, 1.0),
    }


def gripper(*closed):
    values = np.ones(100)
    for first, last in closed:
        values[first:last] = 0.0
    return values


def test_switches_have_hysteresis():
    values = np.array([0.0, 0.1, 0.5, 0.3, 0.5, 0.9, 0.6, 0.4, 0.7, 0.2])
    assert switches(values, (0.0, 1.0)) == [(5, True), (9, False)]
    assert switches(values, (1.0, 0.0)) == [(5, False), (9, True)]


def test_a_gripper_that_is_late_misses_and_switches_too_often():
    found = time_gripper("jaw", [(gripper((33, 53)), gripper((30, 50)))], (0.0, 1.0), FPS)
    assert (found.demonstrated, found.missed, found.extra) == (2, 0, 0)
    assert found.delays_s == pytest.approx((0.3, 0.3))
    never = time_gripper("jaw", [(gripper(), gripper((30, 50)))], (0.0, 1.0), FPS)
    assert (never.missed, never.extra, never.delays_s) == (2, 0, ())
    often = time_gripper("jaw", [(gripper((30, 50), (80, 90)), gripper((30, 50)))], (0.0, 1.0), FPS)
    assert (often.missed, often.extra) == (0, 2)


def test_who_stands_still_where_the_other_moves():
    done = np.arange(100.0)[:, None]
    waits = np.concatenate([np.arange(40.0), np.full(20, 39.0), np.arange(40.0) + 40])[:, None]
    found = find_hesitations([(waits, done)], np.ones(1), FPS)
    assert 0.15 < found.policy_rests < 0.22
    assert found.demonstrator_rests == 0
    assert found.longest_s == pytest.approx(100 * found.policy_rests / FPS)
    back = find_hesitations([(done, waits)], np.ones(1), FPS)
    assert (back.policy_rests, back.demonstrator_rests) == (0, found.policy_rests)
