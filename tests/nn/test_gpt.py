import math

import pytest
import torch

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.gpt import Gpt

B, L, D, LONGEST = 3, 7, 16, 9


def make(n_layers=2, dropout=0.0):
    torch.manual_seed(0)
    gpt = Gpt(dim=D, n_heads=4, n_layers=n_layers, max_tokens=LONGEST, dropout=dropout)
    for parameter in gpt.parameters():  # GPT-2's initial weights are so small that tokens hardly mix
        parameter.data += 0.2 * torch.randn_like(parameter)
    return gpt


@pytest.fixture
def tokens():
    return torch.randn(B, L, D, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize("place", range(L))
def test_a_token_changes_itself_and_those_behind_it_only(tokens, place):
    gpt, other = make(), tokens.clone()
    other[:, place] = torch.randn(B, D)
    change = (gpt(other) - gpt(tokens)).abs().amax((0, 2))
    assert (change > 1e-3).tolist() == [i >= place for i in range(L)]


@pytest.mark.parametrize("n_layers", [1, 3])
@pytest.mark.parametrize("n_last", [1, 3, L])
def test_the_last_tokens_alone_are_the_same_values_and_gradients(tokens, n_layers, n_last):
    gpt = make(n_layers).double()
    results = []
    for call in (lambda x: gpt(x, n_last), lambda x: gpt(x)[:, -n_last:]):
        gpt.zero_grad()
        x = tokens.double().requires_grad_()
        out = call(x)
        out.sin().sum().backward()
        results.append([out, x.grad, *(p.grad.clone() for p in gpt.parameters())])
    torch.testing.assert_close(results[0], results[1], rtol=0, atol=1e-12)


def test_tokens_know_their_place(tokens):
    gpt = make()
    same = tokens[:, :1].expand(-1, L, -1)
    assert (gpt(same).std(1) > 1e-3).all()
    gpt.positions.data[:] = 0
    torch.testing.assert_close(gpt(same), gpt(same)[:, :1].expand(-1, L, -1))


def test_a_shorter_sequence_is_the_beginning_of_a_longer(tokens):
    gpt = make()
    torch.testing.assert_close(gpt(tokens[:, :4]), gpt(tokens)[:, :4])


def test_samples_do_not_mix(tokens):
    gpt = make()
    torch.testing.assert_close(gpt(tokens)[1:2], gpt(tokens[1:2]))


def test_dropout_acts_in_training_alone(tokens):
    gpt = make(dropout=0.5)
    assert not torch.equal(gpt(tokens), gpt(tokens))
    assert torch.equal(gpt.eval()(tokens), gpt(tokens))
    torch.testing.assert_close(gpt(tokens), make()(tokens))


def test_initial_weights_are_gpt2s():
    gpt = Gpt(dim=256, n_heads=4, n_layers=8, max_tokens=50, dropout=0.0)
    block = gpt.blocks[3]
    for weight in (gpt.positions, block.qkv.weight, block.expand.weight, block.contract.weight):
        assert weight.std().item() == pytest.approx(0.02, rel=0.03)
    assert block.mix.weight.std().item() == pytest.approx(0.02 / math.sqrt(16), rel=0.03)
    assert all(not parameter.any() for name, parameter in gpt.named_parameters() if name.endswith("bias"))


def test_too_many_tokens_are_refused():
    with pytest.raises(ValueError, match="10 tokens, but this GPT has positions for max_tokens=9"):
        make()(torch.randn(B, LONGEST + 1, D))


def test_heads_that_do_not_divide_the_width_are_refused():
    with pytest.raises(ConfigurationError, match="gpt_n_head=5 must divide gpt_hidden_dim=16"):
        Gpt(dim=16, n_heads=5, n_layers=1, max_tokens=4, dropout=0.0)
