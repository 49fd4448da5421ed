"""Properties of every action head, whatever its likelihood."""

import pytest
import torch
from head_cases import SAMPLED, head_spec

from lerobot_act_chunking.heads.make import HEADS, make_action_head
from lerobot_act_chunking.heads.spec import HeadSize

B, Q, D, A, S = 3, 5, 16, 4, 2
T = Q * S
IS_PAD = torch.arange(T) >= torch.tensor([[T], [7], [3]])


def make(likelihood, temperature=0.0, **settings):
    torch.manual_seed(0)
    settings = {"n_bins": 32, "n_components": 3} | settings
    spec = head_spec(action_likelihood=likelihood, action_temperature=temperature, **settings)
    return make_action_head(spec, HeadSize(D, A, Q, S))


def uniform(*shape, seed=0):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def draws_for(head, n=B, seed=0):
    return uniform(n, *head.draws_shape, seed=seed) if head.draws_shape else None


@pytest.fixture
def features():
    return torch.randn(B, Q, D, generator=torch.Generator().manual_seed(1))


@pytest.fixture
def actions():
    return uniform(B, T, A, seed=2) * 2 - 1


def loss_and_gradients(head, features, actions, normalization="valid"):
    head.zero_grad()
    features = features.clone().requires_grad_()
    loss = head.loss(features, actions, IS_PAD, normalization)
    loss.sum().backward()
    return loss, features.grad, *(parameter.grad.clone() for parameter in head.parameters())


@pytest.mark.parametrize("likelihood", HEADS)
@pytest.mark.parametrize("normalization", ["valid", "all"])
@pytest.mark.parametrize("garbage", [float("nan"), float("inf"), 1e6])
def test_padding_reaches_neither_loss_nor_gradient(likelihood, normalization, garbage, features, actions):
    head = make(likelihood)
    clean = loss_and_gradients(head, features, actions.masked_fill(IS_PAD[..., None], 0.5), normalization)
    dirty = loss_and_gradients(head, features, actions.masked_fill(IS_PAD[..., None], garbage), normalization)
    assert all(torch.equal(a, b) for a, b in zip(clean, dirty, strict=True))
    assert all(value.isfinite().all() and value.any() for value in clean)


@pytest.mark.parametrize("likelihood", HEADS)
@pytest.mark.parametrize(("b", "t"), [(0, T - 1), (1, 6), (2, 2)])
def test_every_valid_step_counts(likelihood, b, t, features, actions):
    head, changed = make(likelihood).eval(), actions.clone()  # in training, a mixture's chunks compare
    changed[b, t, A - 1] += 0.5
    loss = head.loss(features, actions, IS_PAD, "valid")
    difference = head.loss(features, changed, IS_PAD, "valid") - loss
    assert (difference.abs() > 1e-5).tolist() == [sample == b for sample in range(B)]


@pytest.mark.parametrize("likelihood", HEADS)
def test_a_chunk_counts_by_its_valid_steps(likelihood, features, actions):
    """The batch loss is that of a batch of which every chunk comes alone, weighted by its valid steps."""
    head = make(likelihood).eval()
    batch = head.loss(features, actions, IS_PAD, "valid").mean()
    alone = [head.loss(features[b : b + 1], actions[b : b + 1], IS_PAD[b : b + 1], "valid") for b in range(B)]
    n_valid = (~IS_PAD).sum(1)
    torch.testing.assert_close(batch, (torch.cat(alone) * n_valid).sum() / n_valid.sum())


@pytest.mark.parametrize("likelihood", HEADS)
def test_all_elements_are_the_divisor_if_asked(likelihood, features, actions):
    head = make(likelihood).eval()
    valid, all_ = (head.loss(features, actions, IS_PAD, norm) for norm in ("valid", "all"))
    torch.testing.assert_close(all_ * IS_PAD.numel(), valid * (~IS_PAD).sum())


@pytest.mark.parametrize("likelihood", HEADS)
def test_only_padding_is_no_error(likelihood, features, actions):
    loss = make(likelihood).loss(features, actions, torch.ones_like(IS_PAD), "valid")
    assert loss.tolist() == pytest.approx([0] * B, abs=1e-6)


@pytest.mark.parametrize(
    ("likelihood", "temperature"), [*((n, 0.0) for n in HEADS), *((n, 1.0) for n in SAMPLED)]
)
@pytest.mark.parametrize("block", [1, 2, 3])
def test_block_by_block_is_all_at_once(likelihood, temperature, block, features):
    head = make(likelihood, temperature)
    draws = draws_for(head)
    act = head.actor(draws)
    blocks = [act(part) for part in features.split(block, dim=1)]
    together = head.actor(draws)(features)
    assert together.shape == (B, T, A)
    torch.testing.assert_close(torch.cat(blocks, dim=1), together, rtol=0, atol=1e-5)


@pytest.mark.parametrize("likelihood", SAMPLED)
def test_few_queries_give_the_first_actions(likelihood, features):
    head = make(likelihood, 1.0)
    draws = draws_for(head)
    torch.testing.assert_close(
        head.actor(draws)(features[:, :2]), head.actor(draws)(features)[:, : 2 * S], rtol=0, atol=1e-5
    )


@pytest.mark.parametrize("likelihood", SAMPLED)
def test_the_draws_alone_decide(likelihood, features):
    head = make(likelihood, 1.0)
    first, again = (head.actor(draws_for(head))(features) for _ in range(2))
    assert torch.equal(first, again)
    others = [head.actor(draws_for(head, seed=seed))(features) for seed in range(1, 5)]
    assert any(not torch.equal(first, other) for other in others)


@pytest.mark.parametrize("likelihood", SAMPLED)
def test_chunks_do_not_depend_on_their_neighbours(likelihood, features):
    head = make(likelihood, 1.0)
    draws = draws_for(head)
    alone = head.actor(draws[1:2])(features[1:2])
    torch.testing.assert_close(alone, head.actor(draws)(features)[1:2], rtol=0, atol=1e-5)


@pytest.mark.parametrize("likelihood", SAMPLED)
def test_extreme_draws_are_finite(likelihood, features):
    head = make(likelihood, 1.0)
    for value in (0.0, 0.5, 1 - 2**-24):
        chunk = head.actor(torch.full((B, *head.draws_shape), value))(features)
        assert chunk.isfinite().all()


@pytest.mark.parametrize("likelihood", HEADS)
def test_wrong_draws_are_refused(likelihood, features):
    head = make(likelihood, 1.0 if likelihood in SAMPLED else 0.0)
    with pytest.raises(ValueError, match=r"draws of shape \(99,\) for each chunk, but this head needs"):
        head.actor(torch.rand(B, 99))
    if head.draws_shape:
        with pytest.raises(ValueError, match=r"draws of shape \(\) "):
            head.actor()


@pytest.mark.parametrize("likelihood", HEADS)
def test_gradients_are_those_of_finite_differences(likelihood, features, actions):
    """Beta-NLL and the call to idle components are no gradients of what they return: left out here."""
    head = make(likelihood, nll_beta=0.0, n_bins=10).double().eval()
    small = features[:1, :, :].double().requires_grad_()
    assert torch.autograd.gradcheck(
        lambda x: head.loss(x, actions[:1].double(), IS_PAD[1:2], "valid"), small, atol=1e-6
    )


@pytest.mark.parametrize("likelihood", HEADS)
def test_losses_are_finite_in_half_precision(likelihood, features, actions):
    head = make(likelihood)
    exact = head.loss(features, actions, IS_PAD, "valid")
    with torch.autocast("cpu", torch.bfloat16):
        loss = head.loss(features, actions, IS_PAD, "valid")
        chunk = head.actor(None)(features)
    loss.mean().backward()
    assert loss.dtype == torch.float32
    torch.testing.assert_close(loss, exact, rtol=0.05, atol=0.02)
    assert chunk.isfinite().all()
    assert all(parameter.grad.isfinite().all() for parameter in head.parameters())


@pytest.mark.parametrize("likelihood", HEADS)
def test_far_actions_are_no_trouble(likelihood, features):
    """A damaged scale or an outlier of 1000 standard deviations."""
    head = make(likelihood)
    loss = head.loss(1e3 * features, torch.full((B, T, A), -1e3), IS_PAD, "valid")
    loss.mean().backward()
    assert loss.isfinite().all()
    assert all(parameter.grad.isfinite().all() for parameter in head.parameters())


@pytest.mark.parametrize("likelihood", HEADS)
def test_compiled_names_of_checkpoints(likelihood):
    """Checkpoints of earlier versions hold ``projection``."""
    head = make(likelihood)
    names = {"projection.weight", "projection.bias"}
    extra = {"choice.weight", "choice.bias", "usage"} if likelihood == "gmm" else set()
    assert set(head.state_dict()) == names | extra
