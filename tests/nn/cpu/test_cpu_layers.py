"""Property: the transformer in the CPU's order has the values and gradients of the one of `nn.layers`."""

from dataclasses import replace

import pytest
import torch

from lerobot_act_chunking.nn import layers, transformer
from lerobot_act_chunking.nn.cpu.attention import CpuAttention
from lerobot_act_chunking.nn.cpu.span import Span
from lerobot_act_chunking.nn.layers import LayerSpec

B, N, D = 3, 7, 16
SPEC = LayerSpec(dim=D, n_heads=2, dim_feedforward=24, dropout=0.0, activation="relu", pre_norm=False)
IS_PAD = torch.arange(N) >= torch.tensor([[7], [4], [2]])
SUBLAYERS = ("SelfAttention", "CrossAttention", "FeedForward")


@pytest.fixture(params=[False, True], ids=["post_norm", "pre_norm"])
def spec(request, monkeypatch):
    monkeypatch.setattr("lerobot_act_chunking.nn.cpu.attention._WORTH_A_DETOUR", 0)
    torch.manual_seed(0)
    return replace(SPEC, pre_norm=request.param)


def both(make, monkeypatch):
    """The network as it is, and of the plain layers with its weights."""
    ours = make().double()
    for parameter in ours.parameters():
        parameter.data += 0.2 * torch.randn_like(parameter)
    with monkeypatch.context() as patch:
        for name in SUBLAYERS:
            patch.setattr(transformer, name, getattr(layers, name))
        plain = make().double()
    assert not any(isinstance(module, CpuAttention) for module in plain.modules())
    plain.load_state_dict(ours.state_dict())
    return ours, plain


def output_and_gradients(network, inputs, *arguments):
    output = network(*inputs, *arguments)
    parameters = [inputs[0] if torch.is_tensor(inputs[0]) else inputs[0].vectors, *network.parameters()]
    return output, torch.autograd.grad(output.square().sum(), parameters)


@pytest.mark.parametrize("activation", ["relu", "gelu"])
@pytest.mark.parametrize("n_out", [None, 1, 3])
@pytest.mark.parametrize("pads", [None, IS_PAD], ids=["whole", "padded"])
@pytest.mark.parametrize("n_layers", [1, 2])
@pytest.mark.parametrize("in_span", [False, True])
def test_encoders_are_the_same(spec, activation, n_out, pads, n_layers, in_span, monkeypatch):
    spec = replace(spec, activation=activation)
    ours, plain = both(lambda: transformer.Encoder(spec, n_layers), monkeypatch)
    vectors, positions = torch.randn(4, D, dtype=torch.double, requires_grad=True), torch.randn(N, D).double()
    span = Span(torch.randn(B, N, 4).double(), vectors)
    tokens = span.tokens().detach().requires_grad_()
    found = output_and_gradients(ours, (span if in_span else tokens, positions), pads, n_out)
    if in_span:  # the gradient of the vectors, through the tokens
        plain_encode = lambda x, *rest: plain(x.tokens(), *rest)  # noqa: E731
        plain_encode.parameters = plain.parameters
        torch.testing.assert_close(found, output_and_gradients(plain_encode, (span, positions), pads, n_out))
    else:
        torch.testing.assert_close(found, output_and_gradients(plain, (tokens, positions), pads, n_out))


@pytest.mark.parametrize("n_layers", [1, 2, 3])
@pytest.mark.parametrize(("n_memory", "n_queries"), [(3, 12), (7, 4), (1, 12), (5, 1)])
def test_decoders_are_the_same(spec, n_layers, n_memory, n_queries, monkeypatch):
    ours, plain = both(lambda: transformer.Decoder(spec, n_layers, n_queries), monkeypatch)
    memory = torch.randn(B, n_memory, D, dtype=torch.double, requires_grad=True)
    positions = torch.randn(n_memory, D).double()
    torch.testing.assert_close(*(output_and_gradients(each, (memory, positions)) for each in (ours, plain)))
