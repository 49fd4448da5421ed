import pytest
import torch
from denoiser_cases import A, B, answer, condition, draw, shaken, unet1d
from torch import nn

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.denoisers import short_conv
from lerobot_act_chunking.nn.denoisers.short_conv import ShortConv1d


@pytest.mark.parametrize(("n_levels", "lengths"), [(1, (5, 7)), (2, (6, 10)), (3, (4, 12))])
def test_any_length_that_can_be_halved(n_levels, lengths):
    """LeRobot asks for one halving more than there are."""
    denoiser = unet1d(down_dims=(16, 24, 32)[:n_levels])
    for length in lengths:
        x = draw(B, length, A)
        assert answer(denoiser, x, torch.rand(1), condition()).shape == x.shape


def test_a_length_that_cannot_be_halved():
    with pytest.raises(ConfigurationError, match=r"horizon=18 must be a multiple of 4.* 16 or 20"):
        answer(unet1d(), draw(B, 18, A), torch.rand(1), condition())


def test_one_time_for_all_actions():
    assert not unet1d().per_token_time


@pytest.mark.parametrize("film_scale", [True, False])
def test_film_widths(film_scale):
    channels = 2 * (16 + 24 + 32) + 2 * 32 + 2 * (24 + 16)
    denoiser = unet1d(film_scale=film_scale)
    assert denoiser.modulate(torch.rand(2)).shape == (2, channels * (1 + film_scale))


@pytest.mark.parametrize(("kernel_size", "stride"), [(5, 1), (3, 2), (1, 1)])
def test_convolutions_as_products(kernel_size, stride, monkeypatch):
    torch.manual_seed(0)
    ours = ShortConv1d(4, 6, kernel_size, stride, kernel_size // 2)
    x = draw(B, 4, 10).requires_grad_()
    results = []
    for many in (10**9, 0):
        monkeypatch.setattr(short_conv, "MANY_WEIGHTS", many)
        out = ours(x)
        gradients = torch.autograd.grad(out.square().sum(), [x, *ours.parameters()])
        results.append((out, *gradients))
    torch.testing.assert_close(*results, rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(results[0][0], nn.Conv1d.forward(ours, x), rtol=0, atol=0)


def test_products_only_for_many_weights_and_few_positions(monkeypatch):
    windows, pad = [], nn.functional.pad
    monkeypatch.setattr(short_conv.F, "pad", lambda *args: windows.append(1) or pad(*args))
    wide, narrow = ShortConv1d(1024, 1024, 5, padding=2), ShortConv1d(512, 512, 5, padding=2)
    with torch.no_grad():
        wide(draw(1, 1024, 65)), narrow(draw(1, 512, 16))
        assert not windows
        wide(draw(4, 1024, 16))
    assert windows


def test_jacobian_products_as_real_time_chunking_takes_them():
    denoiser = shaken(unet1d())
    context = denoiser.observe(condition())
    table, cotangent = denoiser.modulate(torch.tensor([0.3])), draw(B, 12, A, seed=8)
    x = draw(B, 12, A).requires_grad_()
    (expected,) = torch.autograd.grad(denoiser(x, table, context), x, cotangent)
    _, vjp = torch.func.vjp(lambda y: denoiser(y, table, context), x.detach())
    torch.testing.assert_close(vjp(cotangent)[0], expected)
