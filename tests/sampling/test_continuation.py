import jaxtyping
import pytest
import torch
from torch import nn

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.sampling import continuation
from lerobot_act_chunking.sampling.continuation import (
    guidance_strengths,
    held,
    prefix_weights,
)

B, T, A = 3, 5, 4
TIMES = torch.arange(10, dtype=torch.float64) / 10  # of ten Euler steps
FLOW = (TIMES, 1 - TIMES)  # alphas, sigmas
ANGLES = torch.linspace(0.1, 1.5, 10, dtype=torch.float64)
VARIANCE_PRESERVING = (ANGLES.sin(), ANGLES.cos())
PROCESSES = {"flow": FLOW, "vp": VARIANCE_PRESERVING}


def normal(*shape, seed=0, dtype=torch.float64):
    return torch.randn(*shape, dtype=dtype, generator=torch.Generator().manual_seed(seed))


class Network(nn.Module):
    """Mixes steps and dimensions with what was computed from an observation, as a denoiser does."""

    def __init__(self, dtype=torch.float64):
        super().__init__()
        torch.manual_seed(0)
        self.norm, self.steps = nn.LayerNorm(A), nn.Conv1d(T, T, 3, padding=1)
        self.dims = nn.Linear(A, A)
        self.to(dtype)

    def forward(self, x, i, memory):
        h = self.norm(x) + memory * (1 + i)
        h = h + nn.functional.scaled_dot_product_attention(self.dims(h), memory, memory)
        return self.dims(nn.functional.mish(self.steps(h)))


def denoiser(dtype=torch.float64):
    network, memory = Network(dtype), normal(B, T, A, seed=1, dtype=dtype)
    return lambda x, i: network(x, i, memory[: len(x)])


def continued(*arguments, vjp="exact", max_weight=5.0):
    return continuation.continued(*arguments, vjp=vjp, max_weight=max_weight)


SOFT = prefix_weights(1, 4, T, "exp")[None].double()


class TestPrefixWeights:
    def test_as_in_the_authors_docstring(self):
        expected = torch.tensor([1, 1, 0.8, 0.6, 0.4, 0.2, 0, 0, 0, 0])
        torch.testing.assert_close(prefix_weights(2, 6, 10, "linear"), expected)

    def test_exp_falls_as_in_the_paper(self):
        falling = torch.tensor([1, 1, 0.8, 0.6, 0.4, 0.2, 0, 0, 0, 0], dtype=torch.float64)
        expected = falling * (falling.exp() - 1) / (torch.e - 1)
        torch.testing.assert_close(prefix_weights(2, 6, 10, "exp").double(), expected, rtol=0, atol=1e-6)

    def test_hard_schedules_hold_to_all_of_the_plan_or_to_the_frozen_steps(self):
        assert prefix_weights(2, 4, 6, "ones").tolist() == [1, 1, 1, 1, 0, 0]
        assert prefix_weights(2, 4, 6, "zeros").tolist() == [1, 1, 0, 0, 0, 0]

    @pytest.mark.parametrize("schedule", ["linear", "exp", "ones", "zeros"])
    def test_nothing_beyond_the_plan_counts(self, schedule):
        assert prefix_weights(4, 2, 6, schedule).tolist() == [1, 1, 0, 0, 0, 0]
        assert prefix_weights(9, 9, 3, schedule).tolist() == [1, 1, 1]
        assert not prefix_weights(3, 0, 6, schedule).any()

    def test_unknown_schedule(self, monkeypatch):
        monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # it would refuse it first
        with pytest.raises(ConfigurationError, match="prefix_attention_schedule 'LINEAR'; choose one of: li"):
            prefix_weights(2, 6, 10, "LINEAR")


class TestExact:
    @pytest.mark.parametrize("process", PROCESSES)
    def test_equals_the_formula_with_a_dense_jacobian(self, process):
        alphas, sigmas = PROCESSES[process]
        denoise, plan, x = denoiser(), normal(B, T, A, seed=2), normal(B, T, A, seed=3)
        guided = continued(denoise, alphas, sigmas, plan, SOFT, max_weight=5.0)
        for i in (0, 1, 5, 9):
            jacobian = torch.autograd.functional.jacobian(lambda x, i=i: denoise(x, i), x)
            clean = denoise(x, i).detach()
            product = torch.einsum("btaBTA,bta->BTA", jacobian, SOFT[..., None] * (plan - clean))
            alpha, sigma = alphas[i].item(), sigmas[i].item()
            weight = min(5.0, (alpha**2 + sigma**2) / (alpha * sigma)) if alpha else 5.0
            torch.testing.assert_close(guided(x, i), clean + sigma * weight * product, rtol=0, atol=1e-12)

    def test_is_the_same_for_a_process_and_for_flow_in_scaled_coordinates(self):
        denoise, plan, x = denoiser(), normal(B, T, A, seed=2), normal(B, T, A, seed=3)
        alphas, sigmas = VARIANCE_PRESERVING
        total = alphas + sigmas
        for vjp in ("exact", "identity"):
            here = continued(denoise, alphas, sigmas, plan, SOFT, vjp=vjp)
            in_flow = continued(
                lambda x, i: denoise(x * total[i], i), alphas / total, sigmas / total, plan, SOFT, vjp=vjp
            )
            for i in range(10):
                torch.testing.assert_close(here(x, i), in_flow(x / total[i], i), rtol=0, atol=1e-12)

    @pytest.mark.parametrize("caller", [torch.no_grad, torch.inference_mode, torch.enable_grad])
    def test_whatever_the_caller_says_about_gradients(self, caller):
        """The captured observation is then an inference tensor, too, as under lerobot-eval."""
        plan, x = normal(B, T, A, seed=2), normal(B, T, A, seed=3)
        with torch.no_grad():
            expected = continued(denoiser(), *FLOW, plan, SOFT)(x, 5)
        with caller():
            result = continued(denoiser(), *FLOW, plan + 0, SOFT + 0)(x + 0, 5)
            assert torch.equal(result, expected)
            assert not result.requires_grad
            unguided = denoiser()(x, 5)
        assert (result - unguided).abs().max() > 0.01

    def test_leaves_no_gradients_behind(self):
        network = Network()
        guided = continued(lambda x, i: network(x, i, x), *FLOW, normal(B, T, A), SOFT)
        guided(normal(B, T, A, seed=3), 5)
        assert all(parameter.grad is None for parameter in network.parameters())


@pytest.mark.parametrize("vjp", ["exact", "identity"])
class TestPlans:
    def test_without_one_nothing_changes(self, vjp):
        denoise = denoiser()
        assert continued(denoise, *FLOW, normal(B, T, A), torch.zeros(1, T), vjp=vjp) is denoise

    def test_environments_without_one_are_not_touched(self, vjp):
        denoise, x = denoiser(), normal(B, T, A, seed=3)
        weights = SOFT.repeat(B, 1)
        weights[1] = 0
        guided = continued(denoise, *FLOW, normal(B, T, A, seed=2), weights, vjp=vjp)(x, 5)
        unguided = denoise(x, 5)
        assert torch.equal(guided[1], unguided[1])
        assert (guided - unguided)[[0, 2]].abs().amax((1, 2)).min() > 0.01

    def test_values_without_weight_do_not_matter(self, vjp):
        denoise, x, plan = denoiser(), normal(B, T, A, seed=3), normal(B, T, A, seed=2)
        other = plan + 9 * (SOFT == 0)[..., None]
        results = [continued(denoise, *FLOW, each, SOFT, vjp=vjp)(x, 5) for each in (plan, other)]
        assert torch.equal(*results)

    def test_weights_and_plan_in_another_precision(self, vjp):
        denoise, x = denoiser(torch.float32), normal(B, T, A, dtype=torch.float32)
        guided = continued(denoise, *FLOW, x + 1, SOFT, vjp=vjp)(x, 5)
        assert guided.dtype == torch.float32


class TestStrength:
    def test_is_bounded_and_defined_everywhere(self):
        alphas, sigmas = torch.tensor([[0.0, 0.5, 1.0, 0.0], [1.0, 0.5, 0.0, 0.0]])
        assert guidance_strengths(alphas, sigmas, 5.0).tolist() == [5.0, 1.0, 0.0, 0.0]
        for vjp in ("exact", "identity"):
            guided = continued(denoiser(), alphas, sigmas, normal(B, T, A), SOFT, vjp=vjp)
            assert all(guided(normal(B, T, A), i).isfinite().all() for i in range(4))

    def test_lands_on_the_plan_if_actions_are_standard_normal(self):
        """The case in which pseudoinverse guidance is exact: f = alpha x / (alpha^2 + sigma^2)."""
        for alphas, sigmas in PROCESSES.values():
            factors = (alphas / (alphas**2 + sigmas**2)).tolist()
            plan, x = normal(B, T, A), normal(B, T, A, seed=3)
            weights = prefix_weights(2, 2, T, "ones")[None]
            guided = continued(
                lambda x, i, factors=factors: factors[i] * x, alphas, sigmas, plan, weights, max_weight=1e9
            )
            torch.testing.assert_close(guided(x, 5)[:, :2], plan[:, :2])
            torch.testing.assert_close(guided(x, 5)[:, 2:], factors[5] * x[:, 2:])

    @pytest.mark.parametrize("max_weight", [0.0, -1.0, float("nan")])
    def test_must_be_positive(self, max_weight):
        with pytest.raises(ConfigurationError, match=f"max_guidance_weight={max_weight} must be positive"):
            continued(denoiser(), *FLOW, normal(B, T, A), SOFT, max_weight=max_weight)

    def test_unknown_jacobian(self, monkeypatch):
        monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
        with pytest.raises(
            ConfigurationError, match="unknown rtc_vjp 'none'; choose one of: exact, identity"
        ):
            continued(denoiser(), *FLOW, normal(B, T, A), SOFT, vjp="none")


class Gaussian:
    """Smooth chunks of one dimension, for which the best estimate and its posterior are known."""

    def __init__(self, n=8):
        steps = torch.arange(n, dtype=torch.float64)
        self.n = n
        self.mean = (steps / 3).sin()
        self.covariance = (-((steps[:, None] - steps) ** 2) / 18).exp() + 0.01 * torch.eye(n)

    def denoiser(self, alphas, sigmas):
        """E[a | x]: the ideal network."""
        gains = [
            alpha * self.covariance @ (alpha**2 * self.covariance + sigma**2 * torch.eye(self.n)).inverse()
            for alpha, sigma in zip(alphas, sigmas, strict=True)
        ]
        return lambda x, i: self.mean[:, None] + gains[i] @ (x - alphas[i] * self.mean[:, None])

    def posterior_mean(self, prefix):
        d = len(prefix)
        gain = self.covariance[:, :d] @ self.covariance[:d, :d].inverse()
        return self.mean + gain @ (prefix - self.mean[:d])

    def draw(self, n):
        """True chunks (n, T)."""
        return self.mean + normal(n, self.n) @ torch.linalg.cholesky(self.covariance).T


def errors(gaussian, n_frozen, n_steps, **guidance):
    """Rms distance of the mean chunk from the posterior's: frozen steps, and the others.

    Euler from zero noise; everything is affine, so that this is the mean over all noises.
    """
    times = torch.arange(n_steps, dtype=torch.float64) / n_steps
    chunks = gaussian.draw(20)
    weights = prefix_weights(n_frozen, n_frozen, gaussian.n, "exp")[None]
    denoise = gaussian.denoiser(times, 1 - times)
    guided = continued(denoise, times, 1 - times, chunks[..., None], weights, **guidance)
    x = torch.zeros_like(chunks)[..., None]
    for i, t in enumerate(times):
        x = x + (guided(x, i) - x) / (1 - t) / n_steps
    error = x[..., 0] - torch.stack([gaussian.posterior_mean(chunk[:n_frozen]) for chunk in chunks])
    return [part.square().mean().sqrt().item() for part in (error[:, :n_frozen], error[:, n_frozen:])]


UNGUIDED = {"max_weight": 1e-9}


def test_exact_guidance_comes_closer_to_the_posterior_than_the_identity():
    gaussian = Gaussian()
    exact = errors(gaussian, 1, 400, vjp="exact", max_weight=10.0)
    identity = errors(gaussian, 1, 400, vjp="identity", max_weight=10.0)
    unguided = errors(gaussian, 1, 400, **UNGUIDED)
    for part in range(2):  # frozen steps, and those that should follow from them
        assert exact[part] < 0.5 * identity[part]
        assert exact[part] < 0.2 * unguided[part]


@pytest.mark.parametrize("vjp", ["exact", "identity"])
def test_errors_of_neighbouring_steps_count_as_if_independent(vjp):
    """A limit of the method: after several frozen steps of a smooth motion, what follows is overdone."""
    gaussian = Gaussian()
    frozen, after = errors(gaussian, 3, 400, vjp=vjp, max_weight=10.0)
    unguided_frozen, unguided_after = errors(gaussian, 3, 400, **UNGUIDED)
    assert frozen < 0.1 * unguided_frozen
    assert 0.3 * unguided_after < after < 0.8 * unguided_after


def test_only_the_identity_moves_a_network_that_is_sure():
    chunk, plan, x = normal(B, T, A), normal(B, T, A, seed=1), normal(B, T, A, seed=2)
    sure = [continued(lambda x, i: chunk, *FLOW, plan, SOFT, vjp=vjp)(x, 5) for vjp in ("exact", "identity")]
    torch.testing.assert_close(sure[0], chunk)
    torch.testing.assert_close(sure[1], chunk + SOFT[..., None] * (plan - chunk))


def test_held_networks_see_and_answer_with_the_plan():
    frozen = torch.tensor([[True, True, False, False, False]])
    x, plan = normal(B, T, A), normal(B, T, A, seed=1)
    seen = []

    def denoise(x, i):
        seen.append((x, i))
        return 2 * x

    result = held(denoise, plan, frozen)(x, 4)
    expected = torch.cat([plan[:, :2], x[:, 2:]], dim=1)
    assert torch.equal(seen[0][0], expected)
    assert seen[0][1] == 4
    assert torch.equal(result, torch.cat([plan[:, :2], 2 * x[:, 2:]], dim=1))
