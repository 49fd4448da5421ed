import math

import pytest
import torch

from lerobot_act_chunking.heads.codes import CodeHead, focal_loss, inverse_cdf_index

N, G, M, D = 3, 5, 4, 16
SHARES = torch.tensor([0.1, 0.0, 0.4, 0.3, 0.2])
LOGITS = SHARES.log()
DRAWS = (torch.arange(10_000) + 0.5) / 10_000


def make(sequential, hidden_dims=(8,), n_codes=G, vocabulary=M):
    torch.manual_seed(0)
    head = CodeHead(D, hidden_dims, n_codes, vocabulary, sequential=sequential)
    if sequential:  # it starts with little weight on the codes before
        head.context.values.data *= 50
    return head


@pytest.fixture
def features():
    return torch.randn(N, D, generator=torch.Generator().manual_seed(1))


@pytest.fixture
def codes():
    return torch.randint(M, (N, G), generator=torch.Generator().manual_seed(2))


def frequencies(draws=DRAWS, *, logits=LOGITS, temperature=1.0, top_p=1.0):
    picked = inverse_cdf_index(logits.expand(len(draws), -1), draws, temperature=temperature, top_p=top_p)
    return torch.bincount(picked, minlength=len(logits)) / len(draws)


def chi_square(observed, expected, n):
    there = expected > 0
    assert not observed[~there].any()
    return (n * (observed[there] - expected[there]) ** 2 / expected[there]).sum().item()


@pytest.mark.parametrize("sequential", [False, True])
@pytest.mark.parametrize("hidden_dims", [(), (8,), (8, 12)])
@pytest.mark.parametrize("n_codes", [1, G])
def test_shapes(features, codes, sequential, hidden_dims, n_codes):
    head = make(sequential, hidden_dims, n_codes)
    assert head.logits(features, codes[:, :n_codes]).shape == (N, n_codes, M)
    sampled = head.sample(features, torch.rand(N, n_codes), temperature=1.0, top_p=1.0)
    assert sampled.shape == (N, n_codes)
    assert sampled.dtype == torch.int64


def test_in_parallel_codes_do_not_matter(features, codes):
    head = make(sequential=False)
    torch.testing.assert_close(head.logits(features, codes), head.logits(features, codes.roll(1, 0)))


@pytest.mark.parametrize("level", range(G))
def test_in_sequence_a_code_changes_the_levels_behind_it_only(features, codes, level):
    head, other = make(sequential=True), codes.clone()
    other[:, level] = (other[:, level] + 1) % M
    change = (head.logits(features, other) - head.logits(features, codes)).abs().amax((0, 2))
    assert (change > 1e-4).tolist() == [g > level for g in range(G)]


@pytest.mark.parametrize("hidden_dims", [(), (8,)])
def test_teacher_forced_logits_are_those_of_sampling(features, hidden_dims, monkeypatch):
    head, seen = make(True, hidden_dims).double(), []

    def watch(logits, draws, **settings):
        seen.append(logits)
        return inverse_cdf_index(logits, draws, **settings)

    monkeypatch.setattr("lerobot_act_chunking.heads.codes.inverse_cdf_index", watch)
    sampled = head.sample(features.double(), torch.rand(N, G), temperature=1.0, top_p=0.9)
    expected = head.logits(features.double(), sampled)
    torch.testing.assert_close(torch.stack(seen, dim=1), expected, rtol=0, atol=1e-12)


def test_levels_have_readouts_of_their_own(features, codes):
    head = make(sequential=True)
    head.context.levels.data[:] = 0
    head.context.values.data[:] = 0
    assert (head.logits(features, codes).std(1) > 1e-3).all()


def test_hundreds_of_codes_learn(features):
    n_codes = 700
    head = make(True, (8,), n_codes, 64)
    codes = torch.randint(64, (N, n_codes))
    focal_loss(head.logits(features, codes), codes, 2.0).sum().backward()
    assert all(torch.isfinite(p.grad).all() and p.grad.any() for p in head.parameters())
    sampled = head.sample(features, torch.rand(N, n_codes), temperature=1.0, top_p=0.9)
    assert sampled.shape == (N, n_codes)


@pytest.mark.parametrize("sequential", [False, True])
def test_the_draws_alone_decide(features, sequential):
    head, draws = make(sequential), torch.rand(N, G)
    first, again = (head.sample(features, draws, temperature=1.0, top_p=1.0) for _ in range(2))
    assert torch.equal(first, again)
    assert not torch.equal(first, head.sample(features, 1 - draws, temperature=1.0, top_p=1.0))


@pytest.mark.parametrize("sequential", [False, True])
def test_samples_follow_the_joint_distribution(sequential):
    """G = 2: the probability of a pair is that of the first code times that of the second after it."""
    head = make(sequential, (), n_codes=2, vocabulary=3)
    feature = torch.randn(1, D, generator=torch.Generator().manual_seed(3))
    pairs = torch.cartesian_prod(torch.arange(3), torch.arange(3))
    log_p = head.logits(feature.expand(9, -1), pairs).log_softmax(-1)
    expected = log_p.gather(-1, pairs[..., None]).sum((1, 2)).exp()
    assert expected.sum().item() == pytest.approx(1)
    n = 20_000
    draws = torch.rand(n, 2, generator=torch.Generator().manual_seed(4))
    sampled = head.sample(feature.expand(n, -1), draws, temperature=1.0, top_p=1.0)
    observed = torch.bincount(sampled @ torch.tensor([3, 1]), minlength=9) / n
    assert chi_square(observed, expected, n) < 26.1  # one in a thousand, 8 degrees of freedom


def test_random_draws_have_the_probabilities():
    n = 100_000
    draws = torch.rand(n, generator=torch.Generator().manual_seed(5))
    assert chi_square(frequencies(draws), SHARES, n) < 16.3  # one in a thousand, 3 degrees of freedom


def test_draws_are_mapped_in_order():
    torch.testing.assert_close(frequencies(), SHARES, rtol=0, atol=2e-4)
    picked = inverse_cdf_index(LOGITS.expand(len(DRAWS), -1), DRAWS, temperature=1.0, top_p=1.0)
    assert (picked.diff() >= 0).all()


def test_temperature_zero_takes_the_likeliest():
    assert frequencies(temperature=0.0)[2] == 1
    assert frequencies(temperature=1e-6)[2] == 1
    assert frequencies(temperature=1e-37, logits=torch.tensor([-1e3, 1e3, 999.0]))[1] == 1


@pytest.mark.parametrize("temperature", [0.1, 0.5, 2.0])
def test_temperature_is_a_power_of_probability(temperature):
    expected = SHARES ** (1 / temperature)
    actual = frequencies(temperature=temperature)
    torch.testing.assert_close(actual, expected / expected.sum(), rtol=0, atol=2e-4)


def test_infinite_temperature_is_uniform():
    logits = torch.tensor([0.0, -3.0, 5.0])
    torch.testing.assert_close(
        frequencies(logits=logits, temperature=1e6), torch.full((3,), 1 / 3), rtol=0, atol=2e-4
    )


@pytest.mark.parametrize(
    ("top_p", "kept"),
    [(1e-9, [2]), (0.39, [2]), (0.41, [2, 3]), (0.69, [2, 3]), (0.71, [2, 3, 4]), (0.95, [0, 2, 3, 4])],
)
def test_top_p_keeps_the_fewest_codes_that_have_it(top_p, kept):
    expected = torch.zeros(5)
    expected[kept] = SHARES[kept]
    torch.testing.assert_close(frequencies(top_p=top_p), expected / expected.sum(), rtol=0, atol=2e-4)


def test_top_p_of_one_keeps_all():
    torch.testing.assert_close(frequencies(top_p=1.0), SHARES, rtol=0, atol=2e-4)


def test_top_p_keeps_one_of_equals():
    assert frequencies(logits=torch.zeros(8), top_p=0.1).amax() == 1
    assert (frequencies(logits=torch.zeros(8), top_p=0.5) > 0).sum() == 4


@pytest.mark.parametrize("top_p", [0.5, 0.999, 1.0])
@pytest.mark.parametrize("draw", [0.0, 1 - 2**-24, 1 - 2**-53, 1.0])
@pytest.mark.parametrize("seed", range(20))
def test_the_edges_never_pick_what_is_impossible(top_p, draw, seed):
    generator = torch.Generator().manual_seed(seed)
    logits = 3 * torch.randn(50, 16, generator=generator)
    impossible = torch.rand(50, 16, generator=generator) < 0.5
    impossible[:, 5] = False
    impossible[:, [0, 15]] = True
    logits[impossible] = -math.inf
    draws = torch.full((50,), draw, dtype=torch.float64)
    picked = inverse_cdf_index(logits, draws, temperature=1.0, top_p=top_p)
    assert not impossible.take_along_dim(picked[:, None], dim=1).any()


@pytest.mark.parametrize("shape", [(), (3,), (3, 5)])
def test_any_number_of_leading_axes(shape):
    picked = inverse_cdf_index(torch.randn(*shape, M), torch.rand(shape), temperature=1.0, top_p=0.9)
    assert picked.shape == shape


def test_half_precision_logits_are_sampled_in_single():
    n = 5000
    logits = torch.zeros(n, 1000, dtype=torch.bfloat16)
    draws = (torch.arange(n) + 0.5) / n
    picked = inverse_cdf_index(logits, draws, temperature=1.0, top_p=1.0)
    assert len(picked.unique()) == 1000


@pytest.mark.parametrize("gamma", [0.0, 0.5, 2.0, 3.0])
def test_focal_loss_is_its_formula(codes, gamma):
    logits = torch.randn(N, G, M, dtype=torch.float64)
    p = logits.softmax(-1).gather(-1, codes[..., None])[..., 0]
    torch.testing.assert_close(
        focal_loss(logits, codes, gamma), -((1 - p) ** gamma) * p.log(), rtol=1e-12, atol=1e-14
    )


def test_focal_loss_without_gamma_is_cross_entropy(codes):
    logits = torch.randn(N, G, M)
    expected = torch.nn.functional.cross_entropy(logits.flatten(0, 1), codes.flatten(), reduction="none")
    torch.testing.assert_close(focal_loss(logits, codes, 0.0).flatten(), expected)


@pytest.mark.parametrize("gamma", [0.0, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("margin", [1e-3, 20.0, 1e4, -1e4])
def test_focal_loss_is_finite_at_certainty(gamma, margin):
    logits = torch.tensor([[margin, 0.0, 0.0]], requires_grad=True)
    loss = focal_loss(logits, torch.tensor([0]), gamma)
    loss.sum().backward()
    assert torch.isfinite(loss).all()
    assert (loss >= 0).all()
    assert torch.isfinite(logits.grad).all()
