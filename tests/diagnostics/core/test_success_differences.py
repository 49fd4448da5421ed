"""Intervals of differences, tests that may be read together, and evidence that may be watched."""

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import betaln
from tiers import draws

from lerobot_act_chunking.diagnostics.core.statistics import (
    Pairs,
    SuccessRate,
    e_values,
    holm,
    letters,
    newcombe,
)

COUNTS = st.integers(0, 60)


def simulated(first, second, episodes, n=10_000):
    """Of n comparisons: how often only the first succeeded so far, and only the second, (n, episodes)."""
    generator = np.random.default_rng(0)
    one, other = (generator.random((n, episodes)) < rate for rate in (first, second))
    return (one & ~other).cumsum(1), (~one & other).cumsum(1)


def test_newcombes_example_of_independent_rates():
    low, high = newcombe(SuccessRate(56, 70), SuccessRate(48, 80))
    assert (low, high) == (pytest.approx(0.0524, abs=1e-4), pytest.approx(0.3339, abs=1e-4))


def test_pairs_without_correlation_are_like_independent_rates():
    pairs = Pairs(both=20, only_first=20, only_second=20, neither=20)
    assert pairs.interval == pytest.approx(newcombe(SuccessRate(40, 80), SuccessRate(40, 80)))


def test_the_more_alike_the_episodes_the_narrower_the_interval():
    alike, apart = Pairs(30, 5, 0, 15), Pairs(15, 20, 15, 0)
    assert alike.difference == apart.difference == 0.1
    assert np.diff(alike.interval) < np.diff(apart.interval)


def test_paired_intervals_are_corrected_for_continuity():
    # Newcombe (1998): phi = (a d - b c - n / 2) / sqrt((a + b)(c + d)(a + c)(b + d)), by hand.
    a, b, c, d = 20, 12, 2, 16
    phi = (a * d - b * c - 25) / math.sqrt(32 * 18 * 22 * 28)
    expected = newcombe(SuccessRate(32, 50), SuccessRate(22, 50), phi)
    assert Pairs(a, b, c, d).interval == pytest.approx(expected)
    assert Pairs(a, b, c, d).interval != pytest.approx(newcombe(SuccessRate(32, 50), SuccessRate(22, 50), 0))


@pytest.mark.parametrize(("first", "second"), [(0.8, 0.6), (0.95, 0.9), (0.5, 0.5)])
def test_the_interval_holds_the_true_difference_as_often_as_it_says(first, second):
    n_studies, episodes = 400, 100
    only_first, only_second = (each[:, -1] for each in simulated(first, second, episodes, n_studies))
    generator, held = np.random.default_rng(1), 0
    for a, b in zip(only_first, only_second, strict=True):
        both = generator.binomial(
            episodes - a - b, first * second / (first * second + (1 - first) * (1 - second))
        )
        low, high = Pairs(int(both), int(a), int(b), int(episodes - a - b - both)).interval
        held += low <= first - second <= high
    assert held / n_studies > 0.92


@settings(max_examples=draws(50, 300), deadline=None)
@given(COUNTS, COUNTS, COUNTS, COUNTS)
def test_who_is_first_does_not_matter(both, only_first, only_second, neither):
    if both + only_first + only_second + neither == 0:
        return
    here, there = Pairs(both, only_first, only_second, neither), Pairs(both, only_second, only_first, neither)
    low, high = there.interval
    assert here.interval == pytest.approx((-high, -low))
    assert here.p_value == pytest.approx(there.p_value)
    assert here.e_value == pytest.approx(there.e_value)
    assert here.interval[0] - 1e-12 <= here.difference <= here.interval[1] + 1e-12


def test_no_episode_is_no_comparison():
    with pytest.raises(ValueError, match="no common episode"):
        Pairs(0, 0, 0, 0)


def test_the_e_value_is_the_mean_of_all_bets():
    shares = (np.arange(100_000) + 0.5) / 100_000
    weights = 6 * shares * (1 - shares)
    bets = shares**9 * (1 - shares) ** 3 / 0.5**12
    assert Pairs(0, 9, 3, 0).e_value == pytest.approx((weights * bets).mean(), rel=1e-6)
    assert Pairs(5, 0, 0, 5).e_value == 1
    assert math.isfinite(Pairs(0, 10**5, 0, 0).e_value)


@pytest.mark.parametrize("rate", [0.5, 0.8, 0.95])
def test_watching_until_it_is_decided_is_wrong_in_one_of_twenty_at_most(rate):
    only_first, only_second = simulated(rate, rate, 200)
    assert (evidence(only_first, only_second) >= math.log(20)).any(1).mean() <= 0.05


@pytest.mark.parametrize("rates", [(0.6, 0.4), (0.8, 0.6), (0.95, 0.75)])
def test_a_difference_of_twenty_points_is_seen_in_half_of_200_episodes(rates):
    decided = evidence(*simulated(*rates, 200)) >= math.log(20)
    first = np.where(decided.any(1), decided.argmax(1) + 1, 200)
    assert np.median(first) <= 100
    assert decided.any(1).mean() > 0.85


def evidence(only_first, only_second):
    """Logarithms of the e-values, as of `Pairs`."""
    found = betaln(only_first + 2, only_second + 2) - betaln(2, 2) + (only_first + only_second) * math.log(2)
    some = Pairs(0, int(only_first[0, -1]), int(only_second[0, -1]), 0)
    assert math.exp(found[0, -1]) == pytest.approx(some.e_value)
    return found


def test_e_values_of_episodes_are_those_of_each_beginning_where_the_first_is_ahead():
    rng = np.random.default_rng(0)
    first, second = (rng.random(60) < rate for rate in (0.7, 0.5))
    found = e_values(first.tolist(), second.tolist())
    for end in range(1, 61):
        pairs = Pairs.of(first[:end].tolist(), second[:end].tolist())
        expected = pairs.e_value if pairs.only_first > pairs.only_second else 0
        assert found[end - 1] == pytest.approx(expected)
    assert not (found * e_values(second.tolist(), first.tolist())).any()


def test_holms_correction():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.9, 0.6]) == [1.0, 1.0]
    assert holm([]) == []


@settings(max_examples=draws(80, 500), deadline=None)
@given(
    st.integers(1, 7).flatmap(
        lambda n: st.tuples(st.just(n), st.sets(st.sampled_from(list(combinations(range(n), 2)) or [(0, 0)])))
    )
)
def test_two_share_a_letter_exactly_if_they_do_not_differ(case):
    count, differ = case
    differ -= {(0, 0)}
    found = letters(count, differ)
    assert all(found)
    for pair in combinations(range(count), 2):
        assert bool(set(found[pair[0]]) & set(found[pair[1]])) == (pair not in differ)


def test_letters_begin_with_the_first():
    assert letters(3, [(0, 2)]) == ["a", "ab", "b"]
    assert letters(2, []) == ["a", "a"]


def test_the_exact_interval_is_never_narrower_than_it_says():
    assert SuccessRate(0, 20).exact_interval == pytest.approx((0, 1 - 0.025 ** (1 / 20)))
    low, high = SuccessRate(19, 20).exact_interval
    wilson = SuccessRate(19, 20).interval
    assert low < wilson[0]
    assert high > wilson[1]
