import pytest
import torch
from torch.distributions import Normal, kl_divergence

from lerobot_act_chunking.nn.style import StyleEncoder, kl_to_standard_normal, sample_latent
from lerobot_act_chunking.nn.transformer import LayerSpec

B, T, A, S, D, L = 3, 5, 4, 6, 16, 8
SPEC = LayerSpec(dim=D, n_heads=2, dim_feedforward=24, dropout=0.0, activation="gelu", pre_norm=True)


def make(state_dim):
    torch.manual_seed(0)
    return StyleEncoder(SPEC, n_layers=2, chunk_size=T, action_dim=A, state_dim=state_dim, latent_dim=L)


@pytest.mark.parametrize("state", [torch.ones(B, S), None], ids=["state", "no_state"])
def test_padded_actions_are_not_seen(state):
    encoder = make(None if state is None else S)
    actions = torch.randn(B, T, A)
    is_pad = torch.arange(T) >= torch.tensor([[5], [3], [1]])
    mean, log_variance = encoder(actions, is_pad, state)
    assert mean.shape == log_variance.shape == (B, L)
    assert not torch.equal(mean, log_variance)
    other = encoder(torch.where(is_pad[..., None], 9.0, actions), is_pad, state)
    assert torch.equal(other[0], mean)
    assert not torch.allclose(encoder(actions + ~is_pad[..., None], is_pad, state)[0], mean)


def test_the_order_of_actions_matters():
    encoder, actions, is_pad = make(None), torch.randn(B, T, A), torch.zeros(B, T, dtype=torch.bool)
    assert not torch.allclose(encoder(actions.flip(1), is_pad, None)[0], encoder(actions, is_pad, None)[0])


def test_the_zero_latent_adds_nothing():
    assert torch.equal(make(S).embed(torch.zeros(B, L)), torch.zeros(B, D))


def test_samples_have_the_posterior_mean_and_variance():
    mean, log_variance = torch.full((4000, L), 2.0), torch.full((4000, L), 3.0).log()
    samples = sample_latent(
        mean, log_variance, torch.randn(4000, L, generator=torch.Generator().manual_seed(0))
    )
    assert samples.mean().item() == pytest.approx(2.0, abs=0.05)
    assert samples.var().item() == pytest.approx(3.0, rel=0.05)


def test_divergence_is_torchs():
    mean, log_variance = torch.randn(B, L), torch.randn(B, L)
    posterior = Normal(mean, (log_variance / 2).exp())
    expected = kl_divergence(posterior, Normal(torch.zeros(L), torch.ones(L))).sum(-1)
    torch.testing.assert_close(kl_to_standard_normal(mean, log_variance), expected)
