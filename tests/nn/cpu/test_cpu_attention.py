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


@pytest.mark.parametrize("shared", [True, False])
def test_a_single_query_is_not_projected_key_by_key(shared, monkeypatch):
    attention = make()
    query, keys, values = torch.randn(1 if shared else B, 1, D), torch.randn(B, N, D), torch.randn(B, N, D)
    is_pad = torch.arange(N) >= torch.tensor([[7], [4], [1]])
    expected = plain(attention)(query, keys, values, is_pad)
    monkeypatch.setattr(Attention, "project_keys_values", None)
    torch.testing.assert_close(attention(query, keys, values, is_pad), expected)


def test_a_single_query_with_dropout_counts_the_bias_of_what_is_left():
    attention = make(dropout=0.4)
    query, keys = torch.randn(B, 1, D), torch.randn(B, N, D)
    torch.nn.init.normal_(attention.v_proj.bias)
    outputs = []
    for attend in (
        attention.forward,
        lambda *x: attention.attend(x[0], *attention.project_keys_values(*x[1:])),
    ):
        torch.manual_seed(1)
        outputs.append(attend(query, keys, keys))
    torch.testing.assert_close(*outputs)


def test_more_queries_than_keys_of_all_heads():
    attention = make()
    queries, keys, values = torch.randn(1, 9, D), torch.randn(B, 4, D), torch.randn(B, 4, D)
    assert attention.factored_is_cheaper(9, 4)
    torch.testing.assert_close(attention(queries, keys, values), plain(attention)(queries, keys, values))
