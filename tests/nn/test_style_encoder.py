import pytest
import torch

from lerobot_act_chunking.nn.layers import LayerSpec
from lerobot_act_chunking.nn.style_encoder import StyleEncoder, StyleInput, pool_actions

B, T, A, S, D, L, P, V, N = 3, 5, 4, 6, 16, 8, 7, 2, 9
SPEC = LayerSpec(dim=D, n_heads=2, dim_feedforward=24, dropout=0.0, activation="gelu", pre_norm=True)
PADS = torch.arange(T) >= torch.tensor([[5], [3], [1]])


def make(state_dim=None, **sees):
    torch.manual_seed(0)
    return StyleEncoder(SPEC, StyleInput(T, A, state_dim, **sees), n_layers=2, latent_dim=L, n_parameters=P)


@pytest.mark.parametrize("action_stride", [1, 2, 3, 7])
@pytest.mark.parametrize("state", [torch.ones(B, S), None], ids=["state", "no_state"])
def test_padded_actions_are_not_seen(state, action_stride):
    encoder = make(None if state is None else S, action_stride=action_stride)
    actions = torch.randn(B, T, A)
    parameters = encoder(actions, PADS, state)
    assert parameters.shape == (B, P)
    for padding in (9.0, float("nan")):
        assert torch.equal(encoder(actions.masked_fill(PADS[..., None], padding), PADS, state), parameters)
    assert not torch.allclose(encoder(actions + ~PADS[..., None], PADS, state), parameters)


def test_a_nan_in_the_padding_does_not_reach_gradients():
    encoder = make(S, action_stride=2)
    actions = torch.randn(B, T, A).masked_fill(PADS[..., None], float("nan"))
    encoder(actions, PADS, torch.ones(B, S)).sum().backward()
    assert all(p.grad.isfinite().all() for p in encoder.parameters() if p.grad is not None)


@pytest.mark.parametrize("action_stride", [1, 2])
def test_the_order_of_actions_matters(action_stride):
    encoder, actions = make(action_stride=action_stride), torch.randn(B, T, A)
    is_pad = torch.zeros(B, T, dtype=torch.bool)
    assert not torch.allclose(encoder(actions.flip(1), is_pad, None), encoder(actions, is_pad, None))


def test_the_zero_latent_adds_nothing():
    assert torch.equal(make(S).embed(torch.zeros(B, L)), torch.zeros(B, D))


def test_pooled_actions_are_means_of_the_valid_ones():
    actions = torch.arange(T, dtype=torch.float)[None, :, None] + torch.tensor([[[0.0, 10.0]]])
    is_pad = torch.tensor([[False, False, False, True, True]])
    means, pads = pool_actions(actions, is_pad, 2)
    assert means.tolist() == [[[0.5, 10.5], [2.0, 12.0], [0.0, 0.0]]]
    assert pads.tolist() == [[False, False, True]]
    same, _ = pool_actions(actions, torch.zeros_like(is_pad), 1)
    assert torch.equal(same, actions)


def test_a_last_window_that_is_shorter_is_no_mix_with_zeros():
    means, pads = pool_actions(torch.full((B, T, A), 3.0), torch.zeros(B, T, dtype=torch.bool), 3)
    assert torch.equal(means, torch.full((B, 2, A), 3.0))
    assert not pads.any()


def test_strides_shorten_the_sequence():
    encoder, lengths = make(S, action_stride=2), []
    encoder.encoder.layers[0].register_forward_pre_hook(
        lambda _, args: lengths.append(args[0].tokens().shape[1])
    )
    encoder(torch.randn(B, T, A), PADS, torch.ones(B, S))
    assert lengths == [1 + 1 + 3]


@pytest.mark.parametrize("n_tokens", [V, V + 1, N])
def test_observation_tokens_are_seen_by_name_and_cameras_as_their_mean(n_tokens):
    encoder, tokens = make(S, n_vector_tokens=V), torch.randn(B, n_tokens, D)
    actions, state = torch.randn(B, T, A), torch.ones(B, S)

    def encode(tokens):
        return encoder(actions, PADS, state, tokens)

    assert not torch.allclose(encode(tokens + 1), encode(tokens))
    assert not torch.allclose(encode(tokens.roll(1, dims=1)), encode(tokens))
    swapped = torch.cat((tokens[:, :V], tokens[:, V:].flip(1)), dim=1)
    torch.testing.assert_close(encode(swapped), encode(tokens))


def test_observation_tokens_get_no_gradient():
    encoder, tokens = make(n_vector_tokens=V), torch.randn(B, N, D, requires_grad=True)
    encoder(torch.randn(B, T, A), PADS, None, tokens).sum().backward()
    assert tokens.grad is None
    assert encoder.token_proj.weight.grad.abs().sum() > 0


def test_missing_observation_tokens_are_named():
    with pytest.raises(ValueError, match="sees observation tokens"):
        make(n_vector_tokens=V)(torch.randn(B, T, A), PADS, None)


def test_parameter_names_are_those_of_earlier_checkpoints():
    names = {name.split(".")[0] for name in make(S).state_dict()}
    assert names == {"cls", "state_proj", "action_proj", "encoder", "posterior_proj", "latent_proj"}
