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


def test_more_queries_than_keys_of_all_heads():
    attention = make()
    queries, keys, values = torch.randn(1, 9, D), torch.randn(B, 4, D), torch.randn(B, 4, D)
    assert attention.factored_is_cheaper(9, 4)
    torch.testing.assert_close(attention(queries, keys, values), plain(attention)(queries, keys, values))
