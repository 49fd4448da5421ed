import pytest
import torch
from denoiser_cases import PATCH, A, B, T, answer, condition, dit, draw, mixer, shaken

from lerobot_act_chunking.errors import ConfigurationError

N_TOKENS = T // PATCH


@pytest.fixture(params=[mixer, dit])
def make(request):
    """The two that work on tokens."""
    torch.manual_seed(0)
    return request.param


def test_a_new_network_answers_nearly_zero_and_sees_its_input(make):
    denoiser = make()
    out, other = (
        answer(denoiser, x, torch.rand(B), condition()) for x in (draw(B, T, A), draw(B, T, A, seed=1))
    )
    assert 0 < out.abs().max() < 0.05
    assert not torch.equal(out, other)


def test_blocks_are_the_identity_at_first(make):
    """adaLN-Zero: a new network of any depth passes tokens through."""
    denoiser = make()
    torch.nn.init.normal_(denoiser.contract.weight)
    deep = answer(denoiser, draw(B, T, A), torch.rand(B), condition())
    denoiser.blocks = torch.nn.ModuleList()
    shallow = denoiser.contract(
        torch.nn.functional.layer_norm(
            denoiser.expand(draw(B, T, A).reshape(B, N_TOKENS, -1)) + denoiser.positions, (16,)
        )
    )
    torch.testing.assert_close(deep, shallow.reshape(B, T, A))


@pytest.mark.parametrize("patch_size", [1, 4])
def test_tokens_are_consecutive_actions(make, patch_size):
    """Without blocks, each token answers for its own actions only."""
    denoiser = shaken(make(patch_size=patch_size, n_layers=0))
    x = draw(B, T, A)
    changed = x.clone()
    changed[:, patch_size] += 1.0  # first action of the second token
    before, after = (answer(denoiser, y, torch.rand(1).fill_(0.3), condition()) for y in (x, changed))
    moved = (before - after).abs().amax((0, 2)) > 1e-6
    assert moved.nonzero()[:, 0].tolist() == list(range(patch_size, 2 * patch_size))


def test_tokens_may_have_times_of_their_own(make):
    denoiser, x = shaken(make()), draw(B, T, A)
    assert denoiser.per_token_time
    context, times = denoiser.observe(condition()), torch.full((B, N_TOKENS), 0.3)
    same = denoiser(x, denoiser.modulate(times), context)
    torch.testing.assert_close(same, answer(denoiser, x, times[:, 0], condition()))
    times[1, 2] = 1.0
    moved = (denoiser(x, denoiser.modulate(times), context) - same).abs().amax((1, 2)) > 1e-4
    assert moved.tolist() == [False, True, False]


def test_a_times_place_is_its_tokens(make):
    """Without blocks, a token's time reaches its own actions only."""
    denoiser, x = shaken(make(n_layers=0)), draw(B, T, A)
    context, times = denoiser.observe(condition()), torch.full((1, N_TOKENS), 0.3)
    before = denoiser(x, denoiser.modulate(times), context)
    times[0, 1] = 1.0
    moved = (denoiser(x, denoiser.modulate(times), context) - before).abs().amax((0, 2)) > 1e-6
    assert moved.nonzero()[:, 0].tolist() == list(range(PATCH, 2 * PATCH))


def test_actions_must_fill_their_tokens(make):
    with pytest.raises(ConfigurationError, match="horizon=20 must be divisible by patch_size=3"):
        make(patch_size=3)


def test_dropout_is_off_when_acting(make):
    denoiser = shaken(make(dropout=0.5))
    x, time = draw(B, T, A), torch.full((B,), 0.3)
    assert not torch.equal(answer(denoiser, x, time, condition()), answer(denoiser, x, time, condition()))
    denoiser.eval()
    assert torch.equal(answer(denoiser, x, time, condition()), answer(denoiser, x, time, condition()))
