"""A comparison that ends as soon as it is decided errs as rarely as it says."""

import numpy as np
import pytest

from lerobot_act_chunking.diagnostics.eval.deciding import LEVEL, decide


def comparisons(rates, n, seed=0, episodes=200):
    """Whether each policy of each of n comparisons succeeds in each episode."""
    rng = np.random.default_rng(seed)
    return rng.random((n, len(rates), episodes)) < np.array(rates)[:, None]


def decisions(outcomes, looks=range(25, 201, 25)):
    """How each comparison ends, looked at after each of these numbers of episodes."""
    for one in outcomes:
        for end in looks:
            decision = decide({str(i): row[:end].tolist() for i, row in enumerate(one)}, one.shape[1])
            if decision.decided:
                break
        yield decision


@pytest.mark.parametrize("rates", [(0.5, 0.5), (0.9, 0.9), (0.6, 0.6, 0.6)])
def test_equal_policies_are_rarely_told_apart(rates):
    found = [each.decided for each in decisions(comparisons(rates, 400))]
    assert np.mean(found) <= LEVEL


@pytest.mark.parametrize(("first", "second", "most"), [(0.6, 0.4, 125), (0.8, 0.6, 100), (0.95, 0.75, 75)])
def test_twenty_points_are_seen_in_half_of_the_episodes(first, second, most):
    found = list(decisions(comparisons((second, first), 200)))
    assert np.median([each.episodes for each in found]) <= most  # benchmarks/sequential.py has 10 000 each
    assert np.mean([each.decided and each.best == "1" for each in found]) >= 0.8
    assert not any(each.decided and each.best == "0" for each in found)


def test_the_best_has_to_beat_every_other():
    good, alike, poor = [True] * 60, [True] * 59 + [False], [False] * 60
    assert decide({"good": good, "poor": poor}, 60).decided
    decision = decide({"poor": poor, "good": good, "alike": alike}, 60)
    assert (decision.best, decision.decided, decision.needed) == ("good", False, 3 / LEVEL)
    assert decision.e_values["poor"] > decision.needed > decision.e_values["alike"]


def test_what_was_decided_stays_decided_while_the_best_stays_ahead():
    ahead = [True] * 10
    assert decide({"a": ahead, "b": [False] * 10}, 40).decided
    back = decide({"a": ahead + [False] * 7, "b": [False] * 10 + [True] * 7}, 40)
    assert (back.best, back.decided) == ("a", True)
    overtaken = decide({"a": ahead + [False] * 15, "b": [False] * 10 + [True] * 15}, 40)
    assert (overtaken.best, overtaken.decided) == ("b", False)


def test_order_of_the_policies_does_not_matter():
    (one,) = comparisons((0.7, 0.4), 1)
    rows = {"a": one[0].tolist(), "b": one[1].tolist()}
    assert decide(rows, 200) == decide(dict(reversed(rows.items())), 200)
