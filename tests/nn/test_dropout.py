import pytest
import torch

from lerobot_act_chunking.nn.dropout import Dropout, keep_mask


@pytest.mark.parametrize("p", [0.1, 0.5, 0.93])
def test_drops_with_the_given_probability(p):
    torch.manual_seed(0)
    n = 400_000
    dropped = 1 - keep_mask(torch.Size((n,)), p).float().mean().item()
    assert dropped == pytest.approx(p, abs=4 * (p * (1 - p) / n) ** 0.5)


def test_neighbours_are_independent():
    torch.manual_seed(0)
    kept = keep_mask(torch.Size((100_000, 4)), 0.5).float()  # four elements share one 64-bit draw
    off_diagonal = torch.corrcoef(kept.T) - torch.eye(4)
    assert off_diagonal.abs().max() < 0.02


def test_kept_elements_are_scaled_and_so_are_their_gradients():
    torch.manual_seed(0)
    x = torch.ones(3, 5, 7, requires_grad=True)
    y = Dropout(0.25)(x)
    y.sum().backward()
    assert y.unique().tolist() == pytest.approx([0, 4 / 3])
    assert torch.equal(x.grad, y.detach())


def test_off_outside_training_and_without_probability():
    x = torch.randn(3, 5)
    assert torch.equal(Dropout(0.5).eval()(x), x)
    assert torch.equal(Dropout(0.0)(x), x)


def test_repeats_with_the_generator():
    draws = []
    for _ in range(2):
        torch.manual_seed(3)
        draws.append(Dropout(0.5)(torch.ones(9)))
    assert torch.equal(*draws)
