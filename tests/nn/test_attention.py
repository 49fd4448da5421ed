import pytest
import torch

from lerobot_act_chunking.nn.attention import Attention
from lerobot_act_chunking.nn.cpu.attention import CpuAttention

B, Q, N, D, H = 3, 5, 7, 16, 2


def reference(attention, queries, keys, values, is_pad=None):
    """Head by head and sample by sample, from the formula."""
    q, k, v = attention.q_proj(queries).expand(B, -1, -1), attention.k_proj(keys), attention.v_proj(values)
    out = torch.zeros(B, Q, D)
    d = D // H
    for b in range(B):
        for h in range(H):
            part = slice(h * d, (h + 1) * d)
            scores = q[b, :, part] @ k[b, :, part].T / d**0.5
            if is_pad is not None:
                scores[:, is_pad[b]] = -torch.inf
            out[b, :, part] = scores.softmax(-1) @ v[b, :, part]
    return attention.out_proj(out)


@pytest.fixture(autouse=True)
def detours_are_worth_it_at_any_size(monkeypatch):
    monkeypatch.setattr("lerobot_act_chunking.nn.cpu.attention._WORTH_A_DETOUR", 0)


@pytest.fixture(params=[Attention, CpuAttention])
def attention(request):
    torch.manual_seed(0)
    return request.param(D, H, dropout=0.0)


def test_equals_the_formula(attention):
    queries, keys, values = torch.randn(B, Q, D), torch.randn(B, N, D), torch.randn(B, N, D)
    torch.testing.assert_close(attention(queries, keys, values), reference(attention, queries, keys, values))


def test_padded_keys_are_ignored(attention):
    queries, keys = torch.randn(B, Q, D), torch.randn(B, N, D)
    is_pad = torch.arange(N) >= torch.tensor([[7], [4], [1]])
    out = attention(queries, keys, keys, is_pad)
    torch.testing.assert_close(out, reference(attention, queries, keys, keys, is_pad))
    changed = torch.where(is_pad[..., None], 9.0, keys)
    torch.testing.assert_close(out, attention(queries, changed, changed, is_pad), rtol=0, atol=0)


def test_queries_of_the_whole_batch_are_projected_once(attention):
    queries, keys = torch.randn(1, Q, D), torch.randn(B, N, D)
    torch.testing.assert_close(
        attention(queries, keys, keys), attention(queries.expand(B, -1, -1), keys, keys)
    )


def test_attention_weights_drop_out_in_training_only():
    torch.manual_seed(0)
    attention = Attention(D, H, dropout=0.5)
    x = torch.randn(B, N, D)
    assert not torch.equal(attention(x, x, x), attention(x, x, x))
    attention.eval()
    torch.testing.assert_close(attention(x, x, x), attention(x, x, x), rtol=0, atol=0)


class Adapted(torch.nn.Module):
    """A layer as an adapter wraps it: its weight is not all there is to it."""

    def __init__(self, layer):
        super().__init__()
        self.layer = layer

    @property
    def weight(self):
        return self.layer.weight

    @property
    def bias(self):
        return self.layer.bias

    def forward(self, x):
        return self.layer(x) + 1


@pytest.mark.parametrize("name", ["q_proj", "k_proj", "v_proj", "out_proj"])
@pytest.mark.parametrize("n_queries", [1, 9, 40])
def test_layers_wrapped_by_an_adapter_are_called(attention, name, n_queries):
    setattr(attention, name, Adapted(getattr(attention, name)))
    queries, keys = torch.randn(B, 40, D), torch.randn(B, N, D)
    whole = attention.out_proj(
        torch.nn.functional.scaled_dot_product_attention(
            *(
                layer(x).unflatten(-1, (H, -1)).transpose(1, 2)
                for layer, x in (
                    (attention.q_proj, queries),
                    (attention.k_proj, keys),
                    (attention.v_proj, keys),
                )
            )
        )
        .transpose(1, 2)
        .flatten(2)
    )
    torch.testing.assert_close(attention(queries[:, :n_queries], keys, keys), whole[:, :n_queries])
