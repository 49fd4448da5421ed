import pytest
import torch
from latent_cases import latent_spec
from torch.distributions import Categorical, MixtureSameFamily, MultivariateNormal, Normal, kl_divergence

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.latents.categorical import CategoricalLatent
from lerobot_act_chunking.nn.latents.health import latent_metrics
from lerobot_act_chunking.nn.latents.make import LATENTS, make_latent
from lerobot_act_chunking.nn.latents.mixture import MixtureLatent
from lerobot_act_chunking.nn.latents.normal import kl_between_normals, select_component

B, N, D, L, M, MANY = 3, 5, 16, 4, 6, 20_000
TYPES = sorted(LATENTS)


def rng(seed=0):
    return torch.Generator().manual_seed(seed)


def tokens(n=B):
    return torch.randn(n, N, D, generator=rng(9))


def make(latent_type, **settings):
    torch.manual_seed(0)
    return make_latent(latent_spec(latent_type=latent_type, **settings), D)


def posterior_of(latent, n=B, seed=0):
    noise = torch.randn(n, latent.n_noise, generator=rng(seed + 1))
    return latent.posterior(torch.randn(n, latent.n_parameters, generator=rng(seed)), noise, tokens(n))


@pytest.mark.parametrize("latent_type", TYPES)
def test_sizes(latent_type):
    latent = make(latent_type)
    posterior = posterior_of(latent)
    assert posterior.z.shape == posterior.mean.shape == (B, latent.dim)
    assert posterior.divergence.shape[0] == B
    assert latent.prior(None, tokens()).shape == (B, latent.dim)
    assert latent.prior(torch.randn(B, latent.n_noise), tokens()).shape == (B, latent.dim)


@pytest.mark.parametrize("latent_type", TYPES)
def test_each_sample_has_its_own_noise(latent_type):
    latent = make(latent_type).eval()
    torch.nn.init.normal_(next(iter(latent.parameters()), torch.empty(0)))
    parameters, noise = torch.zeros(B, latent.n_parameters), torch.randn(B, latent.n_noise, generator=rng(3))
    other = noise.clone()
    other[1] = -5 * other[1] + torch.arange(latent.n_noise)
    for draw in (lambda n: latent.posterior(parameters, n, tokens()).z, lambda n: latent.prior(n, tokens())):
        same = (draw(noise) == draw(other)).all(-1)
        assert same[[0, 2]].all()
        assert not same[1]


@pytest.mark.parametrize("latent_type", TYPES)
def test_gradients_reach_the_encoder_through_z_and_divergence(latent_type):
    latent = make(latent_type)
    parameters = torch.randn(B, latent.n_parameters, generator=rng(), requires_grad=True)
    noise = torch.randn(B, latent.n_noise, generator=rng(1))
    for read in (lambda p: p.z[:, 0].sum(), lambda p: p.divergence.sum()):
        (gradient,) = torch.autograd.grad(read(latent.posterior(parameters, noise, tokens())), parameters)
        assert gradient.isfinite().all()
        assert gradient.abs().sum() > 0


@pytest.mark.parametrize("latent_type", TYPES)
def test_half_precision_parameters_are_computed_in_single(latent_type):
    latent = make(latent_type)
    noise = torch.zeros(B, latent.n_noise)
    parameters = torch.randn(B, latent.n_parameters, generator=rng()).bfloat16()
    assert latent.posterior(parameters, noise, tokens()).divergence.dtype == torch.float32


def test_the_divergence_from_a_standard_normal_is_torchs():
    latent = make("gaussian")
    parameters = torch.randn(B, 2 * L, generator=rng())
    mean, log_variance = parameters.chunk(2, -1)
    posterior = latent.posterior(parameters, torch.zeros(B, latent.n_noise), tokens())
    expected = kl_divergence(Normal(mean, (log_variance / 2).exp()), Normal(torch.zeros(L), torch.ones(L)))
    torch.testing.assert_close(posterior.divergence, expected)
    assert torch.equal(posterior.z, mean)
    assert torch.equal(posterior.mean, mean)


def test_the_divergence_between_normals_is_torchs():
    values = torch.randn(4, B, L, generator=rng()).unbind()
    q, p = (Normal(m, (v / 2).exp()) for m, v in (values[:2], values[2:]))
    torch.testing.assert_close(kl_between_normals(*values), kl_divergence(q, p))


def test_samples_of_the_posterior_have_its_mean_and_variance():
    latent = make("gaussian")
    parameters = torch.tensor([2.0] * L + [3.0] * L).log().expand(MANY, -1)
    z = latent.posterior(parameters, torch.randn(MANY, latent.n_noise, generator=rng()), tokens(MANY)).z
    torch.testing.assert_close(z.mean(0), parameters[0, :L], atol=0.05, rtol=0)
    torch.testing.assert_close(z.var(0), torch.full((L,), 3.0), atol=0.1, rtol=0)


def test_extreme_variances_stay_finite():
    for latent in (make("gaussian"), make("conditional")):
        for extreme in (-1e4, 1e4):
            parameters = torch.full((B, 2 * L), extreme)
            posterior = latent.posterior(parameters, torch.ones(B, latent.n_noise), tokens())
            assert posterior.divergence.isfinite().all()


def test_a_gaussian_acts_with_zero_or_a_standard_normal():
    latent = make("gaussian", z_temperature=0.5)
    assert torch.equal(latent.prior(None, tokens()), torch.zeros(B, L))
    noise = torch.randn(B, latent.n_noise, generator=rng())
    torch.testing.assert_close(latent.prior(noise, tokens()), 0.5 * noise[:, :L])


def fitted(**settings):
    latent = make("gaussian", **settings)
    means = 10 * torch.eye(L)[:3]
    scales = torch.tensor([1.0, 0.5, 0.1])[:, None, None] * torch.eye(L)
    scales[0, 1, 0] = 0.9  # correlated
    latent.fit_density(torch.tensor([0.8, 0.15, 0.05]), means, scales)
    return latent, means, scales


@pytest.mark.parametrize(
    ("settings", "shares"),
    [({}, [0.8, 0.15, 0.05]), ({"prior_component_weights": "uniform"}, [1 / 3] * 3)],
    ids=["empirical", "uniform"],
)
def test_a_fitted_density_is_sampled_by_its_weights(settings, shares):
    latent, means, scales = fitted(**settings)
    z = latent.prior(torch.randn(MANY, latent.n_noise, generator=rng()), tokens(MANY))
    component = torch.cdist(z, means).argmin(1)
    torch.testing.assert_close(component.bincount() / MANY, torch.tensor(shares), atol=0.01, rtol=0)
    first = z[component == 0]
    torch.testing.assert_close(first.mean(0), means[0], atol=0.05, rtol=0)
    torch.testing.assert_close(first.T.cov(), scales[0] @ scales[0].T, atol=0.08, rtol=0)


def test_the_mode_and_the_posterior_do_not_depend_on_the_fit():
    latent, plain = fitted()[0], make("gaussian")
    assert torch.equal(latent.prior(None, tokens()), torch.zeros(B, L))
    assert torch.equal(posterior_of(latent).divergence, posterior_of(plain).divergence)


def test_temperature_narrows_components_in_place():
    (cold, means, _), (warm, *_) = fitted(z_temperature=0.1), fitted()
    noise = torch.randn(B, warm.n_noise, generator=rng())
    centre = select_component(warm.weights, noise[:, -1])[:, :3] @ means
    expected = centre + 0.1 * (warm.prior(noise, tokens()) - centre)
    torch.testing.assert_close(cold.prior(noise, tokens()), expected)


def test_a_fit_is_saved_and_an_earlier_checkpoint_loads_strictly():
    latent, *_ = fitted()
    restored = make("gaussian")
    restored.load_state_dict(latent.state_dict())
    noise = torch.randn(B, latent.n_noise, generator=rng())
    assert torch.equal(restored.prior(noise, tokens()), latent.prior(noise, tokens()))
    fresh = make("gaussian")
    fresh.load_state_dict({})
    assert torch.equal(fresh.prior(noise, tokens()), noise[:, :L])


def test_a_second_fit_replaces_the_first():
    latent, *_ = fitted()
    latent.fit_density(torch.ones(1), torch.zeros(1, L), torch.eye(L)[None])
    noise = torch.randn(B, latent.n_noise, generator=rng())
    assert torch.equal(latent.prior(noise, tokens()), noise[:, :L])


def test_a_conditional_prior_starts_standard_and_follows_the_observation():
    latent = make("conditional", z_temperature=0.5)
    noise = torch.randn(B, L, generator=rng())
    torch.testing.assert_close(latent.prior(noise, tokens()), 0.5 * noise)
    torch.nn.init.normal_(latent.predict[-1].weight)
    modes = latent.prior(None, tokens())
    assert not torch.allclose(modes[0], modes[1])
    shuffled = tokens().flip(1)  # a set of tokens, not a sequence
    torch.testing.assert_close(latent.prior(None, shuffled), modes)
    spread = latent.prior(noise, tokens()) - modes
    torch.testing.assert_close(latent.prior(2 * noise, tokens()) - modes, 2 * spread)


def test_a_conditional_divergence_is_that_from_its_prior():
    latent = make("conditional")
    torch.nn.init.normal_(latent.predict[-1].weight, std=0.3)
    mean, deviation = latent.prior(None, tokens()), latent.prior(torch.ones(B, L), tokens())
    prior = Normal(mean, deviation - mean)
    parameters = torch.randn(B, 2 * L, generator=rng())
    q = Normal(parameters[:, :L], (parameters[:, L:] / 2).exp())
    found = latent.posterior(parameters, torch.zeros(B, L), tokens()).divergence
    torch.testing.assert_close(found, kl_divergence(q, prior))


def clusters(n, centres, seed=0):
    """Parameters of posteriors around centres, with standard deviation 0.1 in both senses."""
    which = torch.arange(n) % len(centres)
    mean = centres[which] + 0.1 * torch.randn(n, L, generator=rng(seed))
    return torch.cat((mean, torch.full((n, L), 2 * torch.log(torch.tensor(0.1)))), -1)


CENTRES = torch.tensor([[3.0, 0, 0, 0], [0, -3, 0, 0], [0, 0, 3, 1.0]])


def warmed_up(**settings):
    latent = MixtureLatent(L, 3, warmup_steps=4, **settings)
    for step in range(5):
        parameters = clusters(30, CENTRES, seed=step)
        latent.posterior(parameters, torch.zeros(30, latent.n_noise), tokens(30))
    return latent


def test_a_mixture_is_standard_until_its_components_are_placed():
    latent = MixtureLatent(L, 3, warmup_steps=4)
    for step in range(4):
        assert not latent.placed
        parameters = clusters(30, CENTRES, seed=step)
        posterior = latent.posterior(parameters, torch.zeros(30, latent.n_noise), tokens(30))
        gaussian = make("gaussian").posterior(parameters, torch.zeros(30, L), tokens(30))
        torch.testing.assert_close(posterior.divergence[:, 0], gaussian.divergence.sum(-1))
    noise = torch.randn(B, latent.n_noise, generator=rng())
    assert torch.equal(latent.prior(noise, tokens()), noise[:, :L])
    latent.posterior(parameters, torch.zeros(30, latent.n_noise), tokens(30))
    assert latent.placed


def test_components_are_placed_where_encodings_are():
    latent = warmed_up()
    found = latent.means[torch.cdist(CENTRES, latent.means).argmin(1)]
    torch.testing.assert_close(found, CENTRES, atol=0.1, rtol=0)
    # within a cluster and of each posterior, 0.01 each; the latter's average has come from 1 to 0.82
    assert (latent.log_variances.exp() < 1.0).all()
    torch.testing.assert_close(latent.logits.softmax(-1), torch.full((3,), 1 / 3), atol=0.01, rtol=0)


def test_evaluation_neither_counts_nor_places():
    latent = MixtureLatent(L, 3, warmup_steps=1).eval()
    for _ in range(3):
        posterior_of(latent)
    assert not latent.placed
    assert not latent.means.any()


def test_the_mixtures_density_is_torchs():
    latent = warmed_up()
    latent.logits.data = torch.randn(3, generator=rng())
    z = torch.randn(B, L, generator=rng())
    scales = (latent.log_variances / 2).exp()
    components = MultivariateNormal(latent.means, scale_tril=scales.diag_embed())
    expected = MixtureSameFamily(Categorical(logits=latent.logits), components).log_prob(z)
    torch.testing.assert_close(latent.log_prior(z), expected)


def test_the_one_sample_divergence_of_a_mixture_is_right_on_average():
    """With all components alike, the mixture is one normal, whose divergence has a closed form."""
    latent = warmed_up().eval()
    latent.means.data[:] = torch.tensor([0.5, -0.2, 0.0, 1.0])
    latent.log_variances.data[:] = torch.tensor([0.3, -0.5, 0.0, 0.8])
    parameters = torch.randn(1, 2 * L, generator=rng())
    noise = torch.randn(MANY, latent.n_noise, generator=rng(1))
    found = latent.posterior(parameters.expand(MANY, -1), noise, tokens(MANY)).divergence
    expected = kl_between_normals(*parameters.chunk(2, -1), latent.means[:1], latent.log_variances[:1]).sum()
    assert found.shape == (MANY, 1)
    error = found.std().item() / MANY**0.5
    assert found.mean().item() == pytest.approx(expected.item(), abs=4 * error)


def test_mixture_components_learn_once_placed():
    latent = warmed_up()
    posterior_of(latent).divergence.sum().backward()
    for parameter in latent.parameters():
        assert parameter.grad is not None
        assert parameter.grad.abs().sum() > 0


def test_uniform_mixture_weights_are_not_learned():
    latent = warmed_up(uniform=True)
    posterior_of(latent).divergence.sum().backward()
    assert latent.logits.grad is None
    assert not latent.logits.any()


def test_a_mixture_is_sampled_around_its_components():
    latent = warmed_up(temperature=0.1).eval()
    latent.logits.data = torch.tensor([0.5, 0.2, 0.3]).log()
    z = latent.prior(torch.randn(MANY, latent.n_noise, generator=rng()), tokens(MANY))
    distance, component = torch.cdist(z, latent.means).min(1)
    torch.testing.assert_close(component.bincount() / MANY, torch.tensor([0.5, 0.2, 0.3]), atol=0.01, rtol=0)
    deviation = (latent.log_variances / 2).exp()
    assert (distance < 0.1 * 6 * deviation.max() * L**0.5).all()


def test_the_mode_of_a_mixture_is_its_highest_peak():
    latent = warmed_up().eval()
    latent.log_variances.data[:] = 0.0
    latent.log_variances.data[1] = -1.0
    torch.testing.assert_close(latent.prior(None, tokens()), latent.means[1].expand(B, -1))
    latent.logits.data[2] = 5.0
    torch.testing.assert_close(latent.prior(None, tokens()), latent.means[2].expand(B, -1))


def test_a_resumed_warm_up_places_the_same_components():
    half, whole = MixtureLatent(L, 3, warmup_steps=4), warmed_up()
    for step in range(2):
        half.posterior(clusters(30, CENTRES, seed=step), torch.zeros(30, half.n_noise), tokens(30))
    resumed = MixtureLatent(L, 3, warmup_steps=4)
    resumed.load_state_dict(half.state_dict())
    for step in range(2, 5):
        resumed.posterior(clusters(30, CENTRES, seed=step), torch.zeros(30, resumed.n_noise), tokens(30))
    assert torch.equal(resumed.means, whole.means)


def test_fewer_encodings_than_components():
    latent = MixtureLatent(L, M, warmup_steps=1)
    for step in range(2):
        latent.posterior(clusters(2, CENTRES, seed=step), torch.zeros(2, latent.n_noise), tokens(2))
    assert latent.placed
    assert (latent.means != 0).any(1).sum() == 2


def test_codes_are_one_hot_with_the_relaxations_gradient():
    latent = CategoricalLatent(M, anneal_steps=1)
    posterior_of(latent)
    parameters = 0.1 * torch.randn(B, M, generator=rng())
    noise = torch.randn(B, M, generator=rng(1))
    z = latent.posterior(parameters.requires_grad_(), noise, tokens()).z
    assert z.detach().sort(-1).values.round(decimals=5).tolist() == [[0.0] * (M - 1) + [1.0]] * B
    gumbel = -(-torch.special.ndtr(noise.double()).log()).log()
    relaxed = ((10 * parameters.double()).log_softmax(-1) + gumbel).div(0.3).softmax(-1)
    weights = torch.arange(float(M))
    (expected,) = torch.autograd.grad((relaxed * weights).sum(), parameters)
    (found,) = torch.autograd.grad((z * weights).sum(), parameters)
    torch.testing.assert_close(found, expected, atol=1e-3, rtol=1e-3)


def test_codes_are_sampled_by_their_probability():
    latent = CategoricalLatent(M, anneal_steps=1)
    parameters = 0.1 * torch.randn(1, M, generator=rng())
    noise = torch.randn(MANY, M, generator=rng(1))
    posterior = latent.posterior(parameters.expand(MANY, -1), noise, tokens(MANY))
    torch.testing.assert_close(posterior.z.mean(0), posterior.mean[0], atol=0.015, rtol=0)


def test_the_divergence_of_codes_is_torchs():
    latent = CategoricalLatent(M, anneal_steps=1)
    parameters = 0.2 * torch.randn(B, M, generator=rng())
    posterior = latent.posterior(parameters, torch.zeros(B, M), tokens())
    q = Categorical(probs=posterior.mean)
    expected = kl_divergence(q, Categorical(logits=torch.zeros(B, M)))
    torch.testing.assert_close(posterior.divergence[:, 0], expected)


def test_the_relaxation_hardens_in_training_alone():
    latent, temperatures = CategoricalLatent(M, anneal_steps=2), []
    for step in range(4):
        latent.train(step != 1)
        temperatures.append(latent.relaxation.item())
        posterior_of(latent)
    assert temperatures == pytest.approx([1.0, 0.65, 0.65, 0.3])


def used_codes(**settings):
    """Codes 1, 2 and 4 in use, as training has seen."""
    latent = CategoricalLatent(M, anneal_steps=1, **settings)
    logits = torch.full((20, M), -5.0)
    logits[torch.arange(20), torch.tensor([1] * 14 + [2] * 4 + [4] * 2)] = 5.0
    for _ in range(1000):
        latent.posterior(logits, torch.zeros(20, M), tokens(20))
    return latent.eval()


@pytest.mark.parametrize(
    ("settings", "shares"),
    [
        ({}, [0, 0.7, 0.2, 0, 0.1, 0]),
        ({"uniform": True}, [0, 1 / 3, 1 / 3, 0, 1 / 3, 0]),
        ({"temperature": 0.5}, [0, 0.49 / 0.54, 0.04 / 0.54, 0, 0.01 / 0.54, 0]),
    ],
    ids=["empirical", "uniform", "cold"],
)
def test_only_used_codes_are_sampled(settings, shares):
    latent = used_codes(**settings)
    z = latent.prior(torch.randn(MANY, M, generator=rng()), tokens(MANY))
    torch.testing.assert_close(z.mean(0), torch.tensor(shares, dtype=z.dtype), atol=0.015, rtol=0)
    assert not z[:, [0, 3, 5]].any()
    assert latent.prior(None, tokens()).argmax(-1).tolist() == [1] * B


def test_a_choice_without_weight_is_never_made():
    weights = torch.tensor([0.0, 0.3, 0.0, 0.7, 0.0])
    extremes = select_component(weights, torch.tensor([-9.0, -40.0, 9.0, 40.0]))
    assert extremes.argmax(-1).tolist() == [1, 1, 3, 3]


def test_metrics_of_latent_health():
    mean = torch.tensor([[0.0, 1.0, 0.05], [0.0, -1.0, -0.05]])
    divergence = torch.tensor([[0.0, 2.0, 0.02], [0.0, 3.0, 0.01]])
    metrics = {name: value.item() for name, value in latent_metrics(mean, divergence).items()}
    assert metrics == {"kl_max": 2.5, "kl_active_dims": 2.0, "active_units": 1.0}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"latent_type": "gauss"}, "unknown latent_type 'gauss'; choose one of: gaussian, conditional"),
        ({"prior_component_weights": "even"}, "unknown prior_component_weights 'even'"),
        ({"latent_dim": 0}, "latent_dim=0 must be at least 1"),
        ({"n_latent_components": 1}, "n_latent_components=1 must be at least 2"),
        ({"latent_warmup_steps": 0}, "latent_warmup_steps=0 must be at least 1"),
        (
            {"z_temperature": 0.0},
            "z_temperature=0.0 must be above 0 and at most 100: set z_temperature=1",
        ),
        ({"z_temperature": float("inf")}, "z_temperature=inf must be above 0 and at most 100"),
    ],
)
def test_settings_that_cannot_work(settings, message):
    with pytest.raises(ConfigurationError, match=message):
        make_latent(latent_spec(**settings), D)


@pytest.mark.parametrize("latent_type", TYPES)
def test_each_name_makes_its_latent(latent_type):
    assert type(make(latent_type)) is LATENTS[latent_type]
