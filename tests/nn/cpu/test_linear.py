import pytest
import torch
from torch.nn.functional import linear

from lerobot_act_chunking.nn.cpu.linear import Linear, is_plain


@pytest.mark.parametrize("bias", [True, False])
@pytest.mark.parametrize("sizes", [(6, 11), (11, 6)])
@pytest.mark.parametrize("shape", [(), (1,), (3,), (1, 2), (7, 1), (2, 5), (0,)])
def test_it_is_a_linear_layer_for_any_number_of_rows(shape, sizes, bias, monkeypatch):
    monkeypatch.setattr("lerobot_act_chunking.nn.cpu.linear._LARGE", 0)
    torch.manual_seed(0)
    layer, x = Linear(*sizes, bias=bias), torch.randn(*shape, sizes[0], requires_grad=True)
    y = layer(x)
    assert y.is_contiguous()
    torch.testing.assert_close(y, linear(x, layer.weight, layer.bias))
    ours = torch.autograd.grad(y.square().sum(), (x, layer.weight))
    theirs = torch.autograd.grad(linear(x, layer.weight, layer.bias).square().sum(), (x, layer.weight))
    torch.testing.assert_close(ours, theirs)


def test_a_wrapped_layer_is_not_plain():
    layer = Linear(2, 3)
    assert is_plain(layer, torch.nn.Linear(2, 3))
    assert not is_plain(layer, torch.nn.Sequential(layer))
