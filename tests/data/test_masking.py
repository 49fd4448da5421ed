import pytest
import torch

from lerobot_act_chunking.data.masking import per_sample_error

ERROR = torch.tensor([[[1.0, 3.0], [5.0, 7.0], [9.0, 9.0]], [[2.0, 2.0], [8.0, 8.0], [8.0, 8.0]]])
IS_PAD = torch.tensor([[False, False, True], [False, True, True]])


def test_valid_normalisation_by_hand():
    """Six valid elements: (1 + 3 + 5 + 7 + 2 + 2) / 6, of which the samples bring 16 and 4."""
    loss = per_sample_error(ERROR, IS_PAD, "valid")
    assert loss.tolist() == pytest.approx([2 * 16 / 6, 2 * 4 / 6])
    assert loss.mean().item() == pytest.approx(20 / 6)


def test_all_normalisation_by_hand():
    loss = per_sample_error(ERROR, IS_PAD, "all")
    assert loss.tolist() == pytest.approx([16 / 6, 4 / 6])
    assert loss.mean().item() == pytest.approx(20 / 12)


@pytest.mark.parametrize("normalization", ["valid", "all"])
def test_without_padding_it_is_the_mean_of_each_sample(normalization):
    loss = per_sample_error(ERROR, torch.zeros_like(IS_PAD), normalization)
    torch.testing.assert_close(loss, ERROR.mean((1, 2)))


@pytest.mark.parametrize("normalization", ["valid", "all"])
def test_padded_errors_do_not_enter(normalization):
    changed = torch.where(IS_PAD[..., None], 100.0, ERROR)
    assert torch.equal(
        per_sample_error(changed, IS_PAD, normalization), per_sample_error(ERROR, IS_PAD, normalization)
    )


@pytest.mark.parametrize("normalization", ["valid", "all"])
def test_only_padding_is_no_error(normalization):
    assert per_sample_error(ERROR, torch.ones_like(IS_PAD), normalization).tolist() == [0, 0]


def test_double_precision_is_kept():
    error = torch.rand(7, 3, 2, dtype=torch.float64)
    is_pad = torch.arange(3) >= torch.tensor([[3], [2], [1], [3], [3], [1], [1]])
    expected = error[~is_pad].mean()
    torch.testing.assert_close(per_sample_error(error, is_pad, "valid").mean(), expected, rtol=1e-14, atol=0)
