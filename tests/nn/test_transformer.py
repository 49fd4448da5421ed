from dataclasses import replace

import pytest
import torch

from lerobot_act_chunking.nn.layers import LayerSpec, Residual
from lerobot_act_chunking.nn.transformer import Decoder, Encoder, FeedForward

B, N, D = 3, 7, 16
SPEC = LayerSpec(dim=D, n_heads=2, dim_feedforward=24, dropout=0.0, activation="relu", pre_norm=False)


@pytest.fixture(params=[False, True], ids=["post_norm", "pre_norm"])
def spec(request):
    torch.manual_seed(0)
    return replace(SPEC, pre_norm=request.param)


def shaken(module):
    """The module with every parameter moved off its special initial value."""
    for parameter in module.parameters():
        parameter.data += 0.2 * torch.randn_like(parameter)
    return module


def test_residual_normalises_before_or_after_the_branch():
    x = torch.randn(B, N, D)
    branch = torch.sin
    post, pre = Residual(SPEC), Residual(replace(SPEC, pre_norm=True))
    torch.testing.assert_close(post.add(x, branch), post.norm(x + x.sin()))
    torch.testing.assert_close(pre.add(x, branch), x + pre.norm(x).sin())


def test_residual_keeps_the_tokens_that_the_branch_returns(spec):
    x = torch.randn(B, N, D)
    residual = Residual(spec)
    torch.testing.assert_close(residual.add(x, lambda y: y[:, :2].sin()), residual.add(x, torch.sin)[:, :2])


def test_feed_forward_activation():
    x = torch.randn(B, N, D)
    for name, function in (("relu", torch.relu), ("gelu", torch.nn.functional.gelu)):
        block = FeedForward(replace(SPEC, activation=name, pre_norm=True))
        expected = x + block.contract(function(block.expand(block.norm(x))))
        torch.testing.assert_close(block(x), expected)


def test_encoder_is_equivariant_to_the_order_of_tokens_with_their_positions(spec):
    encoder = shaken(Encoder(spec, n_layers=2))
    x, positions, order = torch.randn(B, N, D), torch.randn(N, D), torch.randperm(N)
    torch.testing.assert_close(encoder(x[:, order], positions[order]), encoder(x, positions)[:, order])


def test_positions_reach_queries_and_keys_but_not_values(spec):
    encoder = shaken(Encoder(spec, n_layers=1))
    x = torch.randn(B, 1, D)  # one token attends to itself alone, whatever the scores are
    torch.testing.assert_close(encoder(x, torch.randn(1, D)), encoder(x, torch.zeros(1, D)))


@pytest.mark.parametrize("n_layers", [1, 3])
def test_the_first_tokens_alone_are_the_same_values_and_gradients(spec, n_layers):
    encoder = shaken(Encoder(spec, n_layers))
    x, positions = torch.randn(B, N, D, requires_grad=True), torch.randn(N, D)
    is_pad = torch.arange(N) >= torch.tensor([[7], [4], [2]])
    results = [encoder(x, positions, is_pad, n_out=2), encoder(x, positions, is_pad)[:, :2]]
    gradients = [torch.autograd.grad(result.square().sum(), x)[0] for result in results]
    torch.testing.assert_close(*results)
    torch.testing.assert_close(*gradients)


@pytest.mark.parametrize("n_layers", [1, 2])
def test_the_first_queries_alone_are_the_same(spec, n_layers):
    decoder = shaken(Decoder(spec, n_layers, n_queries=5))
    memory, positions = torch.randn(B, N, D), torch.randn(N, D)
    few = decoder(memory, positions, n_queries=2)
    assert few.shape == (B, 2, D)
    torch.testing.assert_close(few, decoder(memory, positions)[:, :2])


def test_queries_interact_from_the_second_layer_on(spec):
    memory, positions = torch.randn(B, N, D), torch.randn(N, D)
    for n_layers, interact in ((1, False), (2, True)):
        decoder = shaken(Decoder(spec, n_layers, n_queries=5))
        before = decoder(memory, positions)[:, 0]
        decoder.query_positions.data[4] += 1
        assert torch.equal(before, decoder(memory, positions)[:, 0]) is not interact


def test_dropout_acts_in_training_only(spec):
    spec = replace(spec, dropout=0.5)
    encoder, decoder = Encoder(spec, 1), Decoder(spec, 1, 5)
    x, positions = torch.randn(B, N, D), torch.randn(N, D)

    def run():
        return decoder(encoder(x, positions), positions)

    assert not torch.equal(run(), run())
    encoder.eval(), decoder.eval()
    assert torch.equal(run(), run())


def test_matrices_start_in_the_range_of_a_joint_query_key_value_projection():
    torch.manual_seed(0)
    attention = Encoder(replace(SPEC, dim=64), n_layers=1).layers[0].mix.attention
    limit = (6 / (3 * 64 + 64)) ** 0.5  # Xavier, for one (3D, D) matrix
    for projection in (attention.q_proj, attention.k_proj, attention.v_proj):
        assert 0.98 * limit < projection.weight.abs().max() <= limit
    assert attention.q_proj.bias.abs().max() == 0
