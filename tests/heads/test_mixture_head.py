import pytest
import torch
from torch.distributions import Categorical, Independent, MixtureSameFamily, Normal

from lerobot_act_chunking.heads.mixture import IDLE_SHARE, IDLE_WEIGHT, MixtureHead

B, Q, D, A, S, M = 3, 5, 16, 4, 2, 6
T = Q * S
NO_PAD = torch.zeros(B, T, dtype=torch.bool)
IS_PAD = torch.arange(T) >= torch.tensor([[T], [7], [3]])


def make(temperature=0.0, n_components=M, beta=0.5):
    torch.manual_seed(0)
    return MixtureHead(D, A, S, n_components=n_components, beta=beta, min_std=0.01, temperature=temperature)


def distribution(head, features, n_steps=T):
    """Over flat chunks (B, n_steps * A)."""
    mean, log_std = (x[:, :n_steps].transpose(1, 2).flatten(2) for x in head.components(features))
    components = Independent(Normal(mean, log_std.exp()), 1)
    return MixtureSameFamily(Categorical(logits=head.log_weights(features)), components)


@pytest.fixture
def features():
    return torch.randn(B, Q, D, generator=torch.Generator().manual_seed(1))


@pytest.fixture
def actions():
    return torch.randn(B, T, A, generator=torch.Generator().manual_seed(2))


def test_the_loss_is_the_likelihood_of_the_whole_chunk(features, actions):
    head = make().eval()
    expected = -distribution(head, features).log_prob(actions.flatten(1)) / (T * A)
    torch.testing.assert_close(head.loss(features, actions, NO_PAD, "valid"), expected)


def test_padded_steps_have_no_part_in_the_likelihood(features, actions):
    head = make().eval()
    loss = head.loss(features, actions, IS_PAD, "all") * T * A
    for b, n_steps in enumerate([T, 7, 3]):
        expected = -distribution(head, features, n_steps).log_prob(actions[:, :n_steps].flatten(1))
        torch.testing.assert_close(loss[b], expected[b])


def test_the_component_is_one_for_the_chunk(features):
    head = make(temperature=1.0)
    chunk = head.actor(torch.rand(B, 1))(features)
    means, _ = head.components(features)
    distance = (means - chunk[:, :, None]).abs().amax((1, 3))
    assert (distance.amin(1) == 0).all()


def test_components_are_sampled_by_their_weights(features):
    n, head = 20_000, make(temperature=1.0)
    one = features[:1].expand(n, -1, -1)
    chunks = head.actor(torch.rand(n, 1, generator=torch.Generator().manual_seed(3)))(one)
    means, _ = head.components(features[:1])
    chosen = (means[:, 0] - chunks[:, :1]).abs().sum(-1).argmin(-1)
    expected = n * head.log_weights(features[:1])[0].exp()
    chi_square = ((torch.bincount(chosen, minlength=M) - expected) ** 2 / expected).sum()
    assert chi_square < 20.5  # one in a thousand, 5 degrees of freedom


@pytest.mark.parametrize(("temperature", "draws"), [(0.0, None), (1e-6, torch.rand(B, 1))])
def test_without_temperature_the_likeliest_component(temperature, draws, features):
    head = make(temperature)
    means, _ = head.components(features)
    likeliest = head.log_weights(features).argmax(-1)
    expected = means[torch.arange(B), :, likeliest]
    torch.testing.assert_close(head.actor(draws)(features), expected)


def test_the_choice_follows_from_the_first_query(features):
    head, changed = make(), features.clone()
    changed[:, 1:] = 7
    assert torch.equal(head.log_weights(changed), head.log_weights(features))
    changed[:, 0] = 7
    assert not torch.equal(head.log_weights(changed), head.log_weights(features))


def test_usage_is_counted_in_training_only(features, actions):
    head = make()
    before = head.usage.clone()
    head.eval().loss(features, actions, IS_PAD, "valid")
    assert torch.equal(head.usage, before)
    head.train().loss(features, actions, IS_PAD, "valid")
    assert not torch.equal(head.usage, before)
    assert head.usage.sum().item() == pytest.approx(0.01)  # one batch's weight in the average


def component_gradients(head, features, actions):
    head.zero_grad()
    head.loss(features, actions, IS_PAD, "valid").mean().backward()
    return head.projection.bias.grad.unflatten(0, (S, M, A, 2)).abs().amax((0, 2, 3))


def with_idle_component(index):
    """A head one component of which never wins, and by its usage has not for long."""
    head = make()
    head.projection.bias.data.unflatten(0, (S, M, A, 2))[:, index, :, 0] = 50
    head.usage[:] = 1 / (M - 1)
    head.usage[index] = 0.5 * IDLE_SHARE / M
    return head


def test_an_idle_component_is_called(features, actions):
    """Without the call it would never get a gradient, whatever comes."""
    head = with_idle_component(2)
    assert component_gradients(head, features, actions)[2] > 1e-3
    head.usage[2] = 2 * IDLE_SHARE / M
    assert component_gradients(head, features, actions)[2] == 0


def test_idle_components_move_to_what_is_explained_worst():
    """Chunks with a loss below the average do not count, the others by how much theirs is above it."""
    head = with_idle_component(2)
    nll, log_std = torch.ones(B, T, M, A), torch.full((B, T, M, A), 0.5).log()
    idle = head._idle_loss(nll, log_std, torch.tensor([1.0, 8.0, 6.0]))
    expected = torch.tensor([0.0, 3.0, 1.0]) * 3 / 4 * IDLE_WEIGHT * 0.5 ** (2 - 2 * head.beta) * T * A
    torch.testing.assert_close(idle, expected)


def test_at_first_all_move(features, actions):
    gradients = component_gradients(make(), features, actions)
    assert (gradients > 1e-4).all()


def test_with_all_in_use_training_descends_the_likelihood(features, actions):
    head = make()
    head.usage[:] = 1 / M
    trained = head.loss(features, actions, IS_PAD, "valid")
    assert torch.equal(trained, head.eval().loss(features, actions, IS_PAD, "valid"))


def test_a_batch_of_one_calls_nothing(features, actions):
    head = with_idle_component(2)
    loss = head.loss(features[:1], actions[:1], IS_PAD[:1], "valid")
    assert torch.equal(loss, head.eval().loss(features[:1], actions[:1], IS_PAD[:1], "valid"))


def test_one_component_is_a_gaussian(features, actions):
    head = make(n_components=1).eval()
    mean, log_std = (x[:, :, 0] for x in head.components(features))
    expected = -Normal(mean, log_std.exp()).log_prob(actions).mean((1, 2))
    torch.testing.assert_close(head.loss(features, actions, NO_PAD, "valid"), expected)


@pytest.mark.parametrize("beta", [0.5, 1.0])
def test_beta_scales_the_gradient_of_means_and_nothing_else(beta, features, actions):
    """With one component: the mean's gradient by sigma^(2 beta); loss and the others' gradient stay."""
    gradients = []
    for each in (0.0, beta):
        head = make(n_components=1, beta=each).eval()
        head.projection.bias.data.unflatten(0, (S, 1, A, 2))[..., 1] -= 1
        head.projection.weight.data.unflatten(0, (S, 1, A, 2))[..., 1, :] = 0  # sigma is the same everywhere
        loss = head.loss(features, actions, IS_PAD, "valid")
        loss.mean().backward()
        gradient = head.projection.bias.grad.unflatten(0, (S, A, 2))
        _, log_std = head.components(features[:1, :1])
        gradients.append((loss, gradient[..., 0], gradient[..., 1], log_std[0, :, 0].exp()))
    (loss, mean, raw, std), (other_loss, other_mean, other_raw, _) = gradients
    assert torch.equal(loss, other_loss)
    torch.testing.assert_close(raw, other_raw)
    torch.testing.assert_close(mean * std ** (2 * beta), other_mean)
