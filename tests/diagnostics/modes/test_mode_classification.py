"""Which way a chunk goes: that of the nearest demonstration, or none."""

import numpy as np
import pytest
from planted_gates import demonstrations, of_shares

from lerobot_act_chunking.diagnostics.modes.demonstrated import Reference
from lerobot_act_chunking.diagnostics.modes.sampling import is_deterministic
from lerobot_act_chunking.diagnostics.modes.switching import Switching


@pytest.fixture(scope="module")
def shown():
    return demonstrations(of_shares(100))


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.02])
@pytest.mark.parametrize("length", [12, 16, 22])
def test_other_demonstrations_are_valid_and_of_their_way(noise, length):
    modes = of_shares(60)
    shown, other = demonstrations(modes, noise), demonstrations(modes[::-1], noise, seed=2)
    reference = shown.reference(0, length)
    fresh = shown.scaled(other.reference(0, length).chunks * other.unit)
    assert reference.tells_apart
    np.testing.assert_array_equal(reference.classify(fresh), modes[::-1])


@pytest.mark.parametrize("weight", [0.3, 0.5, 0.7])
def test_between_two_ways_is_none_of_them(shown, weight):
    reference = shown.reference(0, 20)
    first, second = (reference.chunks[shown.modes == mode][0] for mode in (0, 1))
    (found,) = reference.classify((weight * first + (1 - weight) * second)[None])
    assert found == -1


def test_the_limit_lies_between_own_and_other_ways(shown):
    reference = shown.reference(0, 20)
    assert reference.within <= reference.limit < reference.between / 2


def test_standing_still_and_overshooting_are_no_ways(shown):
    reference = shown.reference(0, 20)
    still = np.repeat(reference.chunks[:1, :1], 20, axis=1)
    assert reference.classify(still).tolist() == [-1]
    assert reference.classify(3 * reference.chunks[:3]).tolist() == [-1] * 3


def test_chunks_before_the_ways_part_tell_nothing():
    rng = np.random.default_rng(0)
    chunks = rng.normal(size=(40, 5, 2))
    assert not Reference(chunks, np.arange(40) % 2).tells_apart


def test_of_one_way_only_what_is_far_off_is_invalid():
    rng = np.random.default_rng(0)
    chunks = np.ones((30, 5, 2)) + 0.1 * rng.normal(size=(30, 5, 2))
    reference = Reference(chunks, np.zeros(30, int))
    assert reference.classify(np.stack([chunks[0] + 0.01, chunks[0] + 5])).tolist() == [0, -1]


def test_chunks_behind_the_end_hold_the_last_action(shown):
    reference = shown.reference(15, 20)
    np.testing.assert_array_equal(reference.chunks[0, 10:], np.repeat(shown.motions[0][-1:], 10, axis=0))


def test_the_same_chunk_at_every_sample_is_deterministic():
    chunk = np.random.default_rng(0).normal(size=(4, 1, 5, 2))
    assert is_deterministic(np.repeat(chunk, 3, axis=1))
    assert not is_deterministic(np.concatenate([chunk, chunk + 0.01], axis=1))


def test_where_no_episode_can_be_looked_at_none_has_switched():
    assert Switching(0, 0).share == 0
    assert Switching(4, 1).share == 0.25
