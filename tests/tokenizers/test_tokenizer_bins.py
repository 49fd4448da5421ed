"""Tokenizers that have nothing to learn: every encoding has a decoding, within a bound."""

import math

import numpy as np
import pytest
import scipy.fft
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from tokenizer_cases import A, C, chunks, no_padding, small, state

from lerobot_act_chunking.tokenizers.dct import DctTokenizer, cosines
from lerobot_act_chunking.tokenizers.uniform import UniformTokenizer

EPS = 1e-5


def values(limit):
    return st.tuples(st.integers(1, 4), st.integers(1, 9), st.integers(1, 5)).flatmap(
        lambda shape: arrays(np.float32, shape, elements=st.floats(-limit, limit, width=32))
    )


@given(actions=values(1.0), n_bins=st.integers(2, 300))
def test_uniform_bins_are_half_a_bin_off_at_most(actions, n_bins):
    actions = torch.from_numpy(actions)
    tokenizer = UniformTokenizer(*actions.shape[1:], n_bins)
    codes = tokenizer.encode(actions)
    decoded = tokenizer.decode(codes)
    assert codes.shape == (len(actions), tokenizer.n_codes)
    assert 0 <= codes.min() <= codes.max() < tokenizer.vocabulary == n_bins
    assert (decoded - actions).abs().max() <= 1 / n_bins + EPS
    assert torch.equal(tokenizer.encode(decoded), codes)


def test_uniform_bins_by_hand():
    tokenizer = UniformTokenizer(2, 3, 4)
    actions = torch.tensor([[[-1.0, -0.4, 0.1], [0.9, 1.0, 7.0]], [[-9.0, 0.5, 0.49], [-0.5, 0.0, -0.01]]])
    assert tokenizer.encode(actions).tolist() == [[0, 1, 2, 3, 3, 3], [0, 3, 2, 1, 2, 1]]
    assert tokenizer.decode(torch.tensor([[0, 1, 2, 3, 3, 0]])).tolist() == [
        [[-0.75, -0.25, 0.25], [0.75, 0.75, -0.75]]
    ]


@pytest.mark.parametrize("n", [1, 2, 5, 16])
def test_the_cosine_transform_is_scipys_and_orthonormal(n):
    waves = cosines(n)
    np.testing.assert_allclose(waves.numpy(), scipy.fft.dct(np.eye(n), norm="ortho", axis=0), atol=1e-12)
    torch.testing.assert_close(waves @ waves.T, torch.eye(n, dtype=torch.float64))


@given(actions=values(1.0), n_bins=st.integers(2, 300))
def test_all_coefficients_are_off_by_their_bins_alone(actions, n_bins):
    actions = torch.from_numpy(actions)
    chunk_size = actions.shape[1]
    tokenizer = DctTokenizer(chunk_size, actions.shape[2], n_bins, chunk_size)
    codes = tokenizer.encode(actions)
    error = (tokenizer.decode(codes) - actions).norm(dim=1)
    # Every coefficient is half a bin off at most, and the transform keeps lengths.
    assert error.max() <= math.sqrt(chunk_size) * math.sqrt(chunk_size) / n_bins + 1e-4
    assert 0 <= codes.min() <= codes.max() < n_bins
    assert torch.equal(tokenizer.encode(tokenizer.decode(codes)), codes)


@given(coefficients=arrays(np.float32, (3, 2, A), elements=st.floats(-1, 1, width=32)))
def test_low_frequencies_are_kept_and_high_ones_dropped(coefficients):
    tokenizer = DctTokenizer(C, A, 1001, 2)
    slow = cosines(C)[:2].float().T @ torch.from_numpy(coefficients)
    fast = cosines(C)[3].float()[:, None].expand(C, A)
    bound = math.sqrt(2) * math.sqrt(C) / 1001 + 1e-4
    assert (tokenizer(slow) - slow).norm(dim=1).max() <= bound
    assert (tokenizer(slow + fast) - slow).norm(dim=1).max() <= bound


def test_codes_of_the_transform_are_ordered_by_frequency():
    tokenizer = DctTokenizer(C, A, 9, 4)
    level = torch.tensor([-1.0, 0.0, 1.0]).expand(1, C, A)
    assert tokenizer.encode(level).tolist() == [[0, 4, 8, *[4] * 9]]


@pytest.mark.parametrize("name", ["uniform", "dct"])
def test_nothing_to_learn(name):
    tokenizer = small(name)
    assert not tokenizer.is_learned
    assert not tokenizer.coarse_to_fine
    assert not state(tokenizer)
    with pytest.raises(TypeError, match="Tokenizer has nothing to learn"):
        tokenizer.learn(chunks(), no_padding(), 0)


@pytest.mark.parametrize("name", ["uniform", "dct"])
def test_autocast_changes_no_bin(name):
    tokenizer = small(name)
    codes = tokenizer.encode(chunks())
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(tokenizer.encode(chunks()), codes)
        assert tokenizer.decode(codes).dtype == torch.float32
