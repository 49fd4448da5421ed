"""Causes that can be seen: each is found where it is, and only there."""

import numpy as np
import pytest

from lerobot_act_chunking.diagnostics.core.normalisers import Spread, differing, far_away
from lerobot_act_chunking.diagnostics.core.played import Episode
from lerobot_act_chunking.diagnostics.diagnose import causes
from lerobot_act_chunking.diagnostics.diagnose.demonstrations import Knowledge
from lerobot_act_chunking.diagnostics.diagnose.records import Record
from lerobot_act_chunking.diagnostics.diagnose.starts import out_of_range, starts_outside

RNG = np.random.default_rng(0)
STATE = Spread(np.array([0.3, -1.0]), np.array([0.2, 0.5]))
INERT = Spread(np.zeros(2), np.ones(2))


def record(commands, success=False, still_s=0.0):
    episode = Episode(1, success, {}, 0.0, 0.0, len(commands), "truncated", None, still_s, 1, None, None)
    return Record(episode, commands, commands, np.zeros(len(commands)), 0.1)


def test_processors_that_pass_on_raw_units():
    assert not causes.inert_statistics({"a": STATE}).found
    for broken in ({"a": STATE, "b": INERT}, {"a": STATE, "b": None}):
        found = causes.inert_statistics(broken)
        assert found.found
        assert found.certain
        assert "of b" in found.evidence


def test_statistics_of_other_data():
    moved = Spread(STATE.centre + 0.3, STATE.half)
    wider = Spread(STATE.centre, 3 * STATE.half)
    near = Spread(STATE.centre + 0.02, 1.1 * STATE.half)
    assert differing({"a": moved}, {"a": STATE}, 0.0) == ["a"]
    assert differing({"a": wider}, {"a": STATE}, 0.0) == ["a"]
    assert differing({"a": near}, {"a": STATE}, 0.0) == []
    floored = Spread(STATE.centre, np.array([0.2, 1e-2]))
    assert differing({"a": floored}, {"a": Spread(STATE.centre, np.array([0.2, 1e-6]))}, 1e-2) == []


def test_observations_far_from_the_statistics():
    here = STATE.centre + STATE.half * RNG.standard_normal((50, 2))
    assert far_away({"a": STATE}, {"a": here}) == {}
    assert far_away({"a": STATE}, {"a": here + np.array([0, 10])})["a"] == pytest.approx(20, abs=2)
    assert causes.other_statistics(None, {"a": 20.0}).certain
    assert not causes.other_statistics(["a"], {}).certain  # an intervention decides
    assert not causes.other_statistics([], {}).found


def knows(soon, scatter=0.0, disagreement=None, nearest=0.05):
    return Knowledge(0.1, soon, 0.8, scatter, disagreement, nearest)


def test_who_has_hardly_learned():
    assert causes.hardly_learned(knows(0.75)).certain
    assert not causes.hardly_learned(knows(0.3)).found
    assert causes.hardly_learned(None).found is None
    assert causes.initial_weights("initial").certain
    assert not causes.initial_weights(None).found


def test_training_that_was_too_short_or_on_too_little():
    good, shaky = knows(0.01), knows(0.1)
    assert causes.weak_training(shaky, None).found
    assert not causes.weak_training(good, good).found
    assert "more demonstrations" in causes.weak_training(good, shaky).repair


def test_demonstrations_that_nobody_knows_well_do_not_blame_the_training():
    """Who rests for longer or shorter surprises whoever copies the nearest demonstration even more."""
    finding = causes.weak_training(knows(0.2, nearest=0.5), None)
    assert not finding.found
    assert "25.0 % of the mean action's error, the nearest other demonstration by 62.5 %" in finding.evidence
    assert causes.weak_training(knows(0.2, nearest=None), None).found is None
    assert causes.weak_training(None, None).found is None


def test_hints_of_draws_and_boundaries():
    assert not causes.modes_and_boundaries(knows(0.1, 0.1, 0.1)).found
    assert causes.modes_and_boundaries(knows(0.1, 0.5)).found
    assert causes.modes_and_boundaries(knows(0.1, 0.0, 0.5)).found
    assert causes.modes_and_boundaries(None).found is None


def test_who_holds_still():
    sweep = np.linspace(0, 1, 50)[:, None] * [1.0, 2.0]
    assert not causes.holds_still([record(sweep)] * 3, np.array([1.0, 2.0])).found
    assert not causes.holds_still([record(0.01 * sweep)] * 3, np.array([1.0, 2.0])).found  # it moves on
    found = causes.holds_still([record(0.01 * sweep, still_s=4.0)] * 3, np.array([1.0, 2.0]))
    assert found.found
    assert found.certain
    assert causes.holds_still([record(sweep)], np.zeros(2)).found is None


def test_who_stalls_and_when():
    stalled = [record(np.zeros((50, 1)), still_s=2.0)] * 3
    assert "from 3.0 s on" in causes.stalls(stalled).evidence
    assert causes.stalls(stalled).found
    assert not causes.stalls([record(np.zeros((50, 1)))]).found
    assert causes.stalls([]).found is None


def test_another_control_rate():
    assert causes.control_rate(50.0, 30.0).certain
    assert not causes.control_rate(50.0, 50.0).found
    assert causes.control_rate(None, 50.0).found is None


def starts(n_outside_failing, n_outside_good):
    demonstrated = {"goal": np.linspace(0, 1, 30)[:, None]}
    inside, outside = 0.5, 1.5
    failing = [outside] * n_outside_failing + [inside] * (20 - n_outside_failing)
    good = [outside] * n_outside_good + [inside] * (20 - n_outside_good)
    observed = {"goal": np.array([*failing, *good])[:, None]}
    return starts_outside(demonstrated, observed, np.array([False] * 20 + [True] * 20))


def test_failures_that_start_outside_of_the_demonstrations():
    found = starts(18, 1)
    assert found.failing == (18, 20)
    assert found.succeeding == (1, 20)
    assert found.share == pytest.approx((18 - 2 / 21 * 19) / 20)
    assert "goal[0]" in found.by
    assert out_of_range(found).found
    assert not out_of_range(starts(10, 10)).found
    assert not out_of_range(starts(0, 0)).found
    assert starts(0, 0).share == 0


def test_where_none_succeeds_nothing_is_compared():
    demonstrated, observed = {"goal": np.zeros((5, 1))}, {"goal": np.ones((12, 1))}
    found = out_of_range(starts_outside(demonstrated, observed, np.zeros(12, bool)))
    assert found.found is None


def test_images_that_look_otherwise():
    shape, colours = {"top": (3, 8, 10)}, np.array([0.6, 0.4, 0.1])
    seen = np.clip(colours[:, None, None] + 0.02 * RNG.standard_normal((4, 3, 8, 10)), 0, 1)
    right = {"top": colours}
    assert not causes.images(shape, {"top": seen}, right).found
    assert "swapped" in causes.images(shape, {"top": seen[:, ::-1]}, right).evidence
    assert "0 to 1" in causes.images(shape, {"top": 255 * seen}, {}).evidence
    assert "shape" in causes.images({"top": (3, 4, 4)}, {"top": seen}, right).evidence
    assert "brighter" in causes.images(shape, {"top": np.clip(seen + 0.4, 0, 1)}, right).evidence
    assert not causes.images({}, {}, {}).found
