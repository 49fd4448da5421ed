import pytest
import torch

from lerobot_act_chunking.nn.attention import Attention
from lerobot_act_chunking.nn.cpu.attention import CpuAttention

B, N, D, H = 3, 7, 16, 2


@pytest.fixture(autouse=True)
def detours_are_worth_it_at_any_size(monkeypatch):
    monkeypatch.setattr("lerobot_act_chunking.nn.cpu.attention._WORTH_A_DETOUR", 0)


def make(dropout=0.0):
    torch.manual_seed(0)
    return CpuAttention(D, H, dropout)


def plain(attention):
    """The same weights without the shortcuts."""
    same = Attention(D, H, attention.dropout.p)
    same.load_state_dict(attention.state_dict())
    return same


@pytest.mark.parametrize(
    "is_pad", [None, torch.arange(4) >= torch.tensor([[4], [2], [1]])], ids=["all", "padded"]
)
def test_more_queries_than_keys_of_all_heads(is_pad):
    attention = make()
    queries, keys, values = torch.randn(1, 9, D), torch.randn(B, 4, D), torch.randn(B, 4, D)
    assert attention.factored_is_cheaper(9, 4)
    expected = plain(attention)(queries, keys, values, is_pad)
    torch.testing.assert_close(attention(queries, keys, values, is_pad), expected)


def test_weights_of_more_queries_than_keys_drop_out_in_training_only():
    attention = make(dropout=0.5)
    queries, keys = torch.randn(B, 9, D), torch.randn(B, 4, D)
    assert not torch.equal(attention(queries, keys, keys), attention(queries, keys, keys))
    attention.eval()
    torch.testing.assert_close(attention(queries, keys, keys), plain(attention).eval()(queries, keys, keys))
