"""Given first actions: what is told of them, and how many training draws."""

import torch

from lerobot_act_chunking.nn.prefix import GivenActions, PrefixEncoder, begun_with, draw_prefix

B, T, A, P, D = 3, 5, 4, 2, 16


def encoder():
    torch.manual_seed(0)
    return PrefixEncoder(P, A, D)


def prefix(given):
    actions = torch.randn(B, P, A, generator=torch.Generator().manual_seed(1))
    return GivenActions(actions, torch.tensor(given))


def test_nothing_given_is_zero_and_what_is_not_given_does_not_count():
    one, other = prefix([[True, False], [False, False], [True, True]]), torch.randn(B, P, A)
    told = encoder()(one)
    assert told.shape == (B, D)
    assert not told[1].any()
    assert told[0].abs().sum() > 0
    elsewhere = torch.where(one.given[..., None], one.actions, other)
    assert torch.equal(encoder()(GivenActions(elsewhere, one.given)), told)


def test_an_action_of_zero_is_not_the_same_as_none():
    none, zero = (GivenActions(torch.zeros(B, P, A), torch.full((B, P), known)) for known in (False, True))
    assert not encoder()(none).any()
    assert encoder()(zero).any(1).all()


def test_training_draws_each_length_alike_often():
    chunk = torch.randn(3000, T, A)
    given, which = draw_prefix(chunk, P, torch.Generator().manual_seed(0))
    assert torch.equal(given.actions, chunk[:, :P])
    assert torch.equal(which[:, :P], given.given)
    assert not which[:, P:].any()
    lengths = which.sum(1)
    assert torch.equal(which, torch.arange(T) < lengths[:, None])  # always the first ones
    shares = lengths.bincount() / len(lengths)
    torch.testing.assert_close(shares, torch.full((P + 1,), 1 / (P + 1)), rtol=0, atol=0.03)


def test_a_chunk_begins_with_what_is_given_as_far_as_it_reaches():
    given = prefix([[True, False], [False, False], [True, True]])
    chunk = torch.zeros(B, T, A)
    begun = begun_with(given, chunk)
    assert torch.equal(begun[2, :2], given.actions[2])
    assert torch.equal(begun[0, 0], given.actions[0, 0])
    assert not begun[:, 2:].any()
    assert not begun[1].any()
    assert torch.equal(begun_with(given, chunk[:, :1]), begun[:, :1])
