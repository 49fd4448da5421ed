"""`Gpt` with the weights of LeRobot's GPT between its ``wte`` and ``lm_head``: same outputs and gradients."""

from copy import deepcopy

import pytest
import torch
from lerobot.policies.vqbet.configuration_vqbet import VQBeTConfig
from lerobot.policies.vqbet.vqbet_utils import GPT
from torch.func import functional_call
from vqbet_weights import convert_gpt

from lerobot_act_chunking.nn.gpt import Gpt

B, L, IN, D, OUT, LONGEST = 3, 7, 24, 32, 20, 11


def pair(n_layers, n_heads, seed):
    torch.manual_seed(seed)
    config = VQBeTConfig(
        device="cpu",
        gpt_block_size=LONGEST,
        gpt_input_dim=IN,
        gpt_hidden_dim=D,
        gpt_output_dim=OUT,
        gpt_n_layer=n_layers,
        gpt_n_head=n_heads,
        dropout=0.0,
    )
    theirs = GPT(config)
    for parameter in theirs.parameters():  # from its initial weights alone mistakes would hardly show
        parameter.data += 0.2 * torch.randn_like(parameter)
    ours = Gpt(dim=D, n_heads=n_heads, n_layers=n_layers, max_tokens=LONGEST, dropout=0.0)
    ours.load_state_dict(convert_gpt(theirs.state_dict(), LONGEST), strict=True)
    return theirs, ours


def between(ours, theirs, x, n_last=None):
    """Our GPT between LeRobot's first and last linear maps."""
    return theirs.lm_head(ours(theirs.transformer.wte(x), n_last))


@pytest.fixture(params=[(1, 4, 0), (2, 8, 1), (5, 2, 2)], ids=lambda c: f"{c[0]}-layers-{c[1]}-heads")
def policies(request):
    return pair(*request.param)


@pytest.mark.parametrize("length", [1, L, LONGEST])
def test_answers_are_equal_in_float64(policies, length):
    theirs, ours = (gpt.double() for gpt in policies)
    x = torch.randn(B, length, IN, dtype=torch.float64)
    torch.testing.assert_close(between(ours, theirs, x), theirs(x), rtol=0, atol=1e-12)
    last = between(ours, theirs, x, n_last=1)
    torch.testing.assert_close(last, theirs(x)[:, -1:], rtol=0, atol=1e-12)


def test_gradients_are_equal_in_float64(policies):
    theirs, ours = (gpt.double() for gpt in policies)
    x = torch.randn(B, L, IN, dtype=torch.float64)
    results = []
    for call in (theirs, lambda seen: between_their_weights(ours, theirs, seen)):
        theirs.zero_grad()
        seen = x.clone().requires_grad_()
        call(seen).sin().sum().backward()
        results.append({name: p.grad.clone() for name, p in theirs.named_parameters()} | {"x": seen.grad})
    for name, gradient in results[0].items():
        torch.testing.assert_close(results[1][name], gradient, rtol=1e-10, atol=1e-11, msg=name)


def between_their_weights(ours, theirs, x):
    """As `between`, with gradients to LeRobot's own parameters."""
    weights = convert_gpt(dict(theirs.named_parameters()), LONGEST)
    return theirs.lm_head(functional_call(ours, weights, (theirs.transformer.wte(x),)))


def test_answers_are_equal_but_for_rounding(policies):
    """In float32 both round: neither is much further from the float64 answer than the other."""
    theirs, ours = policies
    x = torch.randn(B, L, IN)
    truth = deepcopy(theirs).double()(x.double())
    error, their_error = ((y - truth).norm() for y in (between(ours, theirs, x), theirs(x)))
    assert error <= 3 * their_error
    assert their_error <= 3e-6 * truth.norm()
