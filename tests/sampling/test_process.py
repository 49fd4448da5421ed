import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from processes import make_diffusion, make_flow
from scipy import stats
from torch import Tensor

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.sampling.process import Process, TwoStep

B, T, A = 3, 5, 4
PROCESSES = [
    *(make_diffusion(prediction_type=prediction) for prediction in ("epsilon", "v_prediction", "sample")),
    make_diffusion("v_prediction", 50, "linear", 1e-3, 0.1),
    *(make_flow(prediction_type=prediction) for prediction in ("velocity", "sample")),
    TwoStep("sample"),
]
processes = pytest.mark.parametrize("process", PROCESSES, ids=lambda p: f"{p.name}-{p.prediction_type}")


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def draw(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=generator(seed), dtype=torch.float64)


@pytest.mark.parametrize("n_steps", [10, 100, 1000])
def test_alpha_bar_is_nichol_and_dhariwals(n_steps: int):
    def f(step: int) -> float:
        return math.cos((step / n_steps + 0.008) / 1.008 * math.pi / 2) ** 2

    expected, alpha_bar = [], 1.0
    for step in range(n_steps):
        alpha_bar *= 1 - min(1 - f(step + 1) / f(step), 0.999)
        expected.append(alpha_bar)
    alphas, sigmas = make_diffusion(num_train_timesteps=n_steps).levels(torch.arange(n_steps).double())
    torch.testing.assert_close(alphas**2, torch.tensor(expected).double(), atol=1e-7, rtol=1e-6)
    torch.testing.assert_close(alphas**2 + sigmas**2, torch.ones(n_steps).double(), atol=1e-12, rtol=0)


def test_linear_betas_are_used_from_start_to_end():
    alphas, _ = make_diffusion("epsilon", 7, "linear", 0.1, 0.4).levels(torch.arange(7).double())
    expected = (1 - torch.linspace(0.1, 0.4, 7).double()).cumprod(0)
    torch.testing.assert_close(alphas**2, expected, atol=1e-7, rtol=0)


@given(which=st.integers(0, len(PROCESSES) - 1), seed=st.integers(0, 10**6))
@settings(max_examples=80, deadline=None)
def test_clean_undoes_the_noise_given_the_target(which: int, seed: int):
    process, actions, noise = PROCESSES[which], draw(B, T, A, seed=seed), draw(B, T, A, seed=seed + 1)
    time = process.draw_times(B, actions, generator(seed))
    x = process.noised(actions, noise, time)
    clean = process.clean(x, process.target(actions, noise, time), time)
    torch.testing.assert_close(clean, actions, atol=1e-9, rtol=0)  # amplified by 1 / alpha <= 2031


@processes
def test_every_action_may_have_a_time_of_its_own(process: Process):
    actions, noise, output = draw(B, T, A), draw(B, T, A, seed=1), draw(B, T, A, seed=2)
    times = process.draw_times(B * T, actions, generator(5)).reshape(B, T)
    for method, other in [(process.noised, noise), (process.target, noise), (process.clean, output)]:
        together = method(actions, other, times)
        for step in range(T):
            alone = method(actions, other, times[:, step])
            torch.testing.assert_close(together[:, step], alone[:, step])


@processes
def test_one_time_may_serve_all(process: Process):
    actions, noise = draw(B, T, A), draw(B, T, A, seed=1)
    time = process.draw_times(1, actions, generator(3))[0]
    torch.testing.assert_close(
        process.noised(actions, noise, time), process.noised(actions, noise, time.expand(B))
    )


@processes
def test_at_the_clean_time_x_is_the_actions(process: Process):
    actions, noise = draw(B, T, A), draw(B, T, A, seed=1)
    time = torch.full((B,), process.clean_time, dtype=torch.float64)
    assert torch.equal(process.noised(actions, noise, time), actions)
    clean = process.clean(actions, process.target(actions, noise, time), time)
    torch.testing.assert_close(clean, actions)


@processes
def test_clean_weights_are_those_of_clean(process: Process):
    x, output = draw(7, T, A), draw(7, T, A, seed=1)
    times = process.draw_times(7, x, generator(4))
    of_x, of_output = process.clean_weights(times)
    by_table = of_x[:, None, None] * x + of_output[:, None, None] * output
    torch.testing.assert_close(by_table, process.clean(x, output, times))


def test_the_ends_of_a_flow():
    actions, noise = draw(B, T, A), draw(B, T, A, seed=1)
    assert torch.equal(make_flow().noised(actions, noise, torch.zeros(B).double()), noise)
    assert torch.equal(make_flow().target(actions, noise, torch.full((B,), 0.3).double()), actions - noise)


def test_two_step_first_sees_nothing_and_then_actions_with_some_noise():
    process, actions, noise = TwoStep("sample", 0.8), draw(B, T, A), draw(B, T, A, seed=1)
    x = process.noised(actions, noise, torch.tensor([0, 0.8, 0.8]).double())
    assert torch.equal(x[0], torch.zeros(T, A).double())
    torch.testing.assert_close(x[1:], (0.8 * actions + 0.2 * noise)[1:])


@pytest.mark.parametrize("prediction", ["epsilon", "v_prediction"])
def test_noise_and_targets_are_those_of_diffusers(prediction: str):
    from diffusers.schedulers.scheduling_ddpm import DDPMScheduler

    process = make_diffusion(prediction)
    theirs = DDPMScheduler(**process.scheduler_settings())
    actions, noise, times = draw(B, T, A).float(), draw(B, T, A, seed=1).float(), torch.tensor([0, 40, 99])
    torch.testing.assert_close(
        process.noised(actions, noise, times.float()), theirs.add_noise(actions, noise, times)
    )
    expected = {"epsilon": noise, "v_prediction": theirs.get_velocity(actions, noise, times)}[prediction]
    torch.testing.assert_close(process.target(actions, noise, times.float()), expected)


DISTRIBUTIONS = {
    "uniform": stats.uniform().cdf,
    "beta": lambda t: stats.beta(1.5, 1).sf(1 - t / 0.999),
    "logit_normal": lambda t: stats.norm.cdf(stats.logistic.ppf(t)),
}


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_times_of_a_flow_are_distributed_as_named(name: str):
    times = make_flow(time_distribution=name).draw_times(5000, torch.zeros(1), generator())
    assert stats.kstest(times.numpy(), DISTRIBUTIONS[name]).pvalue > 0.01


def test_beta_times_prefer_noise():
    times = make_flow(time_distribution="beta").draw_times(5000, torch.zeros(1), generator())
    assert times.mean() == pytest.approx(0.4, abs=0.01)  # 0.999 * (1 - 0.6)
    assert times.max() < 1


def test_times_of_diffusion_are_all_steps_alike():
    times = make_diffusion(num_train_timesteps=7).draw_times(7000, torch.zeros(1), generator())
    counts = times.long().bincount()
    assert len(counts) == 7
    assert counts.min() > 900
    assert torch.equal(times, times.round())


def test_times_of_two_steps_are_either():
    times = TwoStep("sample").draw_times(1000, torch.zeros(1), generator())
    assert set(times.tolist()) == {0, torch.tensor(0.9).item()}
    assert (times > 0).float().mean() == pytest.approx(0.5, abs=0.05)


@processes
def test_drawing_times_reads_its_generator_alone(process: Process):
    state = torch.random.get_rng_state()
    times = process.draw_times(B, torch.zeros(1), generator(1))
    assert torch.equal(times, process.draw_times(B, torch.zeros(1), generator(1)))
    assert not torch.equal(
        process.draw_times(50, torch.zeros(1), generator(1)),
        process.draw_times(50, torch.zeros(1), generator(2)),
    )
    assert torch.equal(torch.random.get_rng_state(), state)


@processes
def test_times_have_at_least_float32(process: Process):
    assert process.draw_times(2, torch.zeros(1, dtype=torch.bfloat16), generator()).dtype == torch.float32
    assert process.draw_times(2, torch.zeros(1, dtype=torch.float64), generator()).dtype == torch.float64


def test_training_goes_on_after_an_evaluation_in_inference_mode():
    process = make_diffusion()
    with torch.inference_mode():
        process.levels(torch.zeros(1))
    weight = torch.ones(B, T, A, requires_grad=True)
    process.clean(weight, weight, torch.full((B,), 50.0)).sum().backward()
    assert weight.grad is not None


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: make_diffusion("velocity"),
            "unknown ddpm prediction_type 'velocity'; choose one of: epsilon, v_",
        ),
        (lambda: make_diffusion(beta_schedule="cosine"), "unknown beta_schedule 'cosine'"),
        (lambda: make_diffusion(num_train_timesteps=0), "num_train_timesteps must be at least 1, but is 0"),
        (
            lambda: make_flow("epsilon"),
            "unknown flow prediction_type 'epsilon'; choose one of: velocity, sample",
        ),
        (lambda: make_flow(time_distribution="normal"), "unknown time_distribution 'normal'"),
        (lambda: TwoStep("velocity"), "unknown two_step prediction_type 'velocity'"),
        (lambda: TwoStep("sample", 1.0), r"refine_time must be between 0 and 1, but is 1\.0"),
    ],
)
def test_impossible_processes_are_refused(make, message: str):
    with pytest.raises(ConfigurationError, match=message):
        make()
