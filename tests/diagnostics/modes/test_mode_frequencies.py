"""Counting ways: shares, coverage, divergences, and the multinomial test."""

import numpy as np
import pytest

from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec
from lerobot_act_chunking.diagnostics.modes.frequencies import Frequencies
from lerobot_act_chunking.diagnostics.modes.settings import Settings, Thresholds, parse_shares
from lerobot_act_chunking.errors import ConfigurationError

SHARES = (0.8, 0.15, 0.05)
USUAL = Thresholds()


def test_all_are_counted_and_what_is_no_way_is_invalid():
    found = Frequencies.of([0, 0, 1, -1, 3], SHARES)
    assert (found.counts, found.invalid, found.n) == ((2, 1, 0), 2, 5)
    assert sum(found.shares) + found.invalid_share == pytest.approx(1)


@pytest.mark.parametrize(("rare", "missing"), [(0, [2]), (2, [2]), (3, []), (10, [])])
def test_a_way_is_covered_from_a_quarter_of_its_share_on(rare, missing):
    found = Frequencies((160, 40 - rare, rare), 0, SHARES)
    assert found.missing(USUAL) == missing
    assert found.good(USUAL) is not bool(missing)


def test_an_undemonstrated_way_need_not_be_taken():
    assert not Frequencies((90, 10, 0), 0, (0.9, 0.1, 0.0)).missing(USUAL)


@pytest.mark.parametrize(("invalid", "good"), [(5, True), (6, False)])
def test_one_in_twenty_may_be_invalid(invalid, good):
    assert Frequencies((80 - invalid, 15, 5), invalid, SHARES).good(USUAL) is good


def test_divergence_is_zero_in_proportion_and_that_of_one_way_its_surprise():
    assert Frequencies((80, 15, 5), 7, SHARES).divergence == pytest.approx(0, abs=1e-12)
    assert Frequencies((10, 0, 0), 0, SHARES).divergence == pytest.approx(-np.log(0.8))
    assert Frequencies((4, 4, 4), 0, SHARES).divergence_from_uniform == pytest.approx(0, abs=1e-12)
    assert Frequencies((1, 0, 1), 0, (0.5, 0.5, 0.0)).divergence is None
    assert Frequencies((0, 0, 0), 3, SHARES).divergence is None


def test_balanced_coverage_is_one_of_equal_shares_and_zero_if_a_way_is_missing():
    assert Frequencies((4, 4, 4), 0, SHARES).balanced_coverage == pytest.approx(1)
    assert Frequencies((8, 4, 0), 0, SHARES).balanced_coverage == 0


def test_the_test_keeps_its_level_and_finds_what_differs():
    rng = np.random.default_rng(0)
    drawn = rng.multinomial(100, SHARES, size=200)
    p_values = [Frequencies(tuple(each.tolist()), 0, SHARES).p_value for each in drawn]
    assert np.mean(np.array(p_values) < 0.05) < 0.1
    assert Frequencies((100, 0, 0), 0, SHARES).p_value < 1e-3
    assert Frequencies((0, 1, 1), 0, (1.0, 0.0, 0.0)).p_value == 0
    assert Frequencies((0, 0, 0), 5, SHARES).p_value is None


def test_two_ways_are_the_exact_binomial_test():
    from scipy.stats import binomtest

    found = Frequencies((13, 7), 0, (0.8, 0.2)).p_value
    assert found == pytest.approx(binomtest(13, 20, 0.8).pvalue, abs=0.01)


@pytest.mark.parametrize("shares", ["80,15", "100", "120,-20", "a,b"])
def test_shares_that_cannot_be_are_refused(shares):
    with pytest.raises(ConfigurationError, match="shares"):
        Settings("x", EnvironmentSpec("three_gates"), shares=parse_shares(shares))


def test_no_shares_are_none():
    assert parse_shares(None) == ()
    assert parse_shares("80,15,5") == (80, 15, 5)
