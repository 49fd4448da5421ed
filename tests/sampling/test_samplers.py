import math
import threading
from collections.abc import Callable, Sequence
from itertools import pairwise

import pytest
import torch
from oracles import Gaussian, Mixture
from torch import Tensor

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.sampling.noise import NoiseSource
from lerobot_act_chunking.sampling.process import Diffusion, Flow, Process, TwoStep
from lerobot_act_chunking.sampling.samplers import check_sampler, make_sampler

B, T, A = 3, 5, 4
EVERY = [
    *((Diffusion(), name, 10) for name in ("ddim", "ddpm", "dpm++")),
    *((Flow(), name, 6) for name in ("euler", "midpoint", "heun", "rk4")),
    (TwoStep(), "two_step", 2),
]
every_sampler = pytest.mark.parametrize(("process", "name", "n"), EVERY, ids=lambda value: str(value)[:8])


def draw(*shape: int, seed: int = 0, dtype: torch.dtype = torch.float32) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def network(x: Tensor, i: int) -> Tensor:
    """Some estimate of clean actions: beyond 1 at times, mixing actions but not environments, not chaotic."""
    phase = torch.arange(T * A).reshape(T, A) + 0.3 * i
    return 1.5 * torch.sin(0.3 * x.flip(1) + 0.1 * x.roll(1, 2) + 2 * phase.sin())


def by_diffusers(scheduler, n: int, x: Tensor, output: Callable[[Tensor, int], Tensor], **step) -> Tensor:
    scheduler.set_timesteps(n)
    for i, t in enumerate(scheduler.timesteps):
        x = scheduler.step(output(x, i), t, x, **step).prev_sample
    return x


def ddim(process: Diffusion, **settings):
    from diffusers.schedulers.scheduling_ddim import DDIMScheduler

    return DDIMScheduler(**process.scheduler_settings() | settings)


def ddpm(process: Diffusion, **settings):
    from diffusers.schedulers.scheduling_ddpm import DDPMScheduler

    return DDPMScheduler(**process.scheduler_settings() | settings)


def dpm(process: Diffusion):
    from diffusers.schedulers.scheduling_dpmsolver_multistep import DPMSolverMultistepScheduler

    return DPMSolverMultistepScheduler(
        **process.scheduler_settings(), timestep_spacing="trailing", lambda_min_clipped=-5.1
    )


def test_a_ddim_step_is_the_formula():
    process = Diffusion()
    sampler = make_sampler(process, "ddim", 2, spacing="trailing")
    assert sampler.times.tolist() == [99, 49]
    (a, middle), (s, middle_s) = (level.double().tolist() for level in process.levels(sampler.times))
    x = draw(B, T, A)
    first = network(x, 0)
    second_x = middle * first + middle_s * (x - a * first) / s
    torch.testing.assert_close(sampler(network, x), network(second_x, 1), atol=1e-6, rtol=0)


@pytest.mark.parametrize("schedule", ["squaredcos_cap_v2", "linear"])
@pytest.mark.parametrize(
    ("spacing", "n"),
    [*(("leading", n) for n in (2, 3, 7, 10, 32, 60, 100)), *(("trailing", n) for n in (1, 4, 10, 100))],
)
def test_ddim_is_that_of_diffusers(spacing: str, n: int, schedule: str):
    process, x = Diffusion(beta_schedule=schedule), draw(B, T, A)
    sampler = make_sampler(process, "ddim", n, spacing=spacing, clip=1.0)
    theirs = ddim(process, timestep_spacing=spacing, clip_sample=True)
    expected = by_diffusers(theirs, n, x, network, use_clipped_model_output=True)
    torch.testing.assert_close(sampler(network, x), expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("n", [10, 25])
def test_lerobots_clipping_keeps_the_direction_of_the_network(n: int):
    process, x = Diffusion(), draw(B, T, A)
    sampler = make_sampler(process, "ddim", n, clip=1.0, clip_mode="lerobot")
    times = sampler.times.double()
    theirs = ddim(process, prediction_type="epsilon", clip_sample=True)

    def noise(x: Tensor, i: int) -> Tensor:
        alpha, sigma = process.levels(times[i])
        return (x - alpha * network(x, i)) / sigma

    expected = by_diffusers(theirs, n, x.double(), noise)
    torch.testing.assert_close(sampler(network, x), expected.float(), atol=3e-6, rtol=0)
    consistent = make_sampler(process, "ddim", n, clip=1.0)(network, x)
    assert (consistent - sampler(network, x)).abs().max() > 0.01


@pytest.mark.parametrize(
    ("process", "name", "n", "spacing"),
    [
        *((Diffusion(), "ddim", 32, spacing) for spacing in ("leading", "trailing", "linspace")),
        (Diffusion(), "dpm++", 16, None),
        *((Flow(), name, 7, None) for name in ("euler", "midpoint", "heun", "rk4")),
    ],
)
def test_x_is_always_at_the_level_that_its_time_says(
    process: Process, name: str, n: int, spacing: str | None
):
    """Not so in diffusers' DDIM where T // n is not the distance of two times, as in trailing 32 of 100."""
    sampler = make_sampler(process, name, n, spacing=spacing)
    actions, noise = draw(B, T, A, dtype=torch.float64), draw(B, T, A, seed=1, dtype=torch.float64)
    times = sampler.times.double()

    def knowing(x: Tensor, i: int) -> Tensor:
        torch.testing.assert_close(x, process.noised(actions, noise, times[i]), atol=1e-5, rtol=0)
        return actions

    result = sampler(knowing, process.noised(actions, noise, times[0]))
    torch.testing.assert_close(result, actions, atol=1e-5, rtol=0)


@pytest.mark.parametrize(
    ("spacing", "n"), [("leading", 10), ("leading", 100), ("trailing", 8), ("linspace", 9)]
)
def test_ddpm_is_that_of_diffusers(spacing: str, n: int):
    process, x = Diffusion(), draw(B, T, A)
    theirs = ddpm(process, timestep_spacing=spacing, clip_sample=True)
    expected = by_diffusers(theirs, n, x, network, generator=torch.Generator().manual_seed(3))
    ours = make_sampler(process, "ddpm", n, spacing=spacing, clip=1.0)
    torch.testing.assert_close(
        ours(network, x, torch.Generator().manual_seed(3)), expected, atol=5e-6, rtol=0
    )


def test_ddpm_takes_a_generator_for_each_row_as_diffusers_does():
    process, x = Diffusion(), draw(B, T, A)
    expected = by_diffusers(
        ddpm(process, clip_sample=False), 10, x, network, generator=NoiseSource(5).generators(B)
    )
    ours = make_sampler(process, "ddpm", 10)(network, x, NoiseSource(5).generators(B))
    torch.testing.assert_close(ours, expected, atol=2e-6, rtol=0)


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
@pytest.mark.parametrize("n", [1, 2, 3, 10, 16, 20, 50])
def test_dpm_solver_is_that_of_diffusers(n: int):
    process, x = Diffusion(), draw(B, T, A)
    expected = by_diffusers(dpm(process), n, x, network)
    assert expected.isfinite().all()
    torch.testing.assert_close(make_sampler(process, "dpm++", n)(network, x), expected, atol=2e-6, rtol=0)


def test_a_flow_by_euler_follows_the_velocity():
    x = start = draw(B, T, A)
    for i in range(6):
        x = x + (network(x, i) - x) / (1 - i / 6) / 6
    sampler = make_sampler(Flow(), "euler", 6)
    torch.testing.assert_close(sampler(network, start), x, atol=1e-6, rtol=0)
    assert sampler.times.tolist() == pytest.approx([0, 1 / 6, 2 / 6, 3 / 6, 4 / 6, 5 / 6])


@pytest.mark.parametrize(("name", "per_step", "last"), [("midpoint", 2, 2), ("heun", 2, 1), ("rk4", 4, 3)])
def test_no_evaluation_of_a_flow_lies_at_its_end(name: str, per_step: int, last: int):
    for n in (1, 2, 5):
        times = make_sampler(Flow(), name, n).times
        assert len(times) == per_step * (n - 1) + last
        assert times.max() < 1
        assert times[0] == 0


def orders(errors: Sequence[float]) -> list[float]:
    """Observed orders of convergence, each from one error to the next, with twice the steps."""
    return [math.log2(coarse / fine) for coarse, fine in pairwise(errors)]


FLOW_ORDERS = pytest.mark.parametrize(
    ("name", "order"), [("euler", 1), ("midpoint", 2), ("heun", 2), ("rk4", 4)]
)


@FLOW_ORDERS
def test_order_of_flow_solvers(name: str, order: int):
    """With their special last step, on a field that is not linear; the reference has 256 steps of rk4."""
    data, x, flow = Mixture((-0.5, 0.7), (0.4, 0.6), 0.4), draw(200, 1, 1, dtype=torch.float64), Flow()

    def solve(name: str, n: int) -> Tensor:
        sampler = make_sampler(flow, name, n)
        return sampler(data.denoise(flow, sampler), x)

    reference = solve("rk4", 256)
    errors = [(solve(name, n) - reference).abs().max().item() for n in (8, 16, 32)]
    assert orders(errors)[-1] == pytest.approx(order, abs=0.25)


@FLOW_ORDERS
def test_order_of_flow_solvers_for_a_gaussian(name: str, order: int):
    """Against the exact solution. On this linear field the midpoint rule is even better than its order."""
    data, x, errors = Gaussian(0.3, 0.5), draw(200, 1, 1, dtype=torch.float64), []
    for n in (4, 8, 16):
        sampler = make_sampler(Flow(), name, n)
        result = sampler(data.denoise(Flow(), sampler), x)
        errors.append((result - data.solution(Flow(), sampler, x)).abs().max().item())
    assert orders(errors)[-1] > order - 0.1


@pytest.mark.parametrize(("name", "lowest"), [("ddim", 0.9), ("dpm++", 1.8)])
def test_order_of_diffusion_solvers(name: str, lowest: float):
    """Half way, against the exact solution: towards both ends no number of steps makes the steps in the log
    of alpha / sigma small, and the errors of the last few, which differ in sign, hide the order."""
    process, data = Diffusion(num_train_timesteps=4000), Gaussian(0.3, 0.5)
    x, errors = draw(200, 1, 1, dtype=torch.float64), []
    half_way = 1983 if name == "dpm++" else 1999
    for n in (20, 40, 80):
        sampler = make_sampler(process, name, n, spacing="trailing")
        denoise, seen = data.denoise(process, sampler), {}

        def watched(x: Tensor, i: int, denoise=denoise, sampler=sampler, seen=seen) -> Tensor:
            seen[int(sampler.times[i])] = x
            return denoise(x, i)

        sampler(watched, x)
        errors.append((seen[half_way] - data.solution(process, sampler, x, half_way)).abs().max().item())
    assert min(orders(errors)) > lowest


def test_dpm_solver_is_the_better_one_with_few_steps():
    data, x, process, errors = Gaussian(0.3, 0.5), draw(200, 1, 1, dtype=torch.float64), Diffusion(), {}
    for name in ("ddim", "dpm++"):
        sampler = make_sampler(process, name, 10, spacing="trailing")
        result = sampler(data.denoise(process, sampler), x)
        errors[name] = (result - data.solution(process, sampler, x)).abs().max().item()
    assert errors["dpm++"] < errors["ddim"] / 2


@pytest.mark.parametrize(
    ("process", "name", "n", "tolerance"),
    [
        # First-order samplers lose variance, half as much with twice the steps; that of ddpm is sampled.
        (Diffusion(), "ddim", 100, 0.03),
        (Flow(), "euler", 100, 0.03),
        (Diffusion(), "ddpm", 100, 0.06),
        (Diffusion(num_train_timesteps=1000), "ddim", 1000, 0.01),
        (Diffusion(num_train_timesteps=1000), "ddpm", 1000, 0.02),
        (Flow(), "euler", 400, 0.01),
        (Diffusion(), "dpm++", 20, 0.01),
        (Flow(), "rk4", 5, 0.01),
    ],
    ids=lambda value: str(value)[:8],
)
def test_a_perfect_denoiser_gives_back_the_distribution(process, name: str, n: int, tolerance: float):
    data, x = Gaussian(0.7, 0.8), antithetic(40_000)
    sampler = make_sampler(process, name, n)
    actions = sampler(data.denoise(process, sampler), x, torch.Generator().manual_seed(1))
    assert actions.mean().item() == pytest.approx(0.7, abs=0.01)
    assert actions.var().item() == pytest.approx(0.64, rel=tolerance)


def antithetic(n: int) -> Tensor:
    """Noise with mean 0 and variance 1 exactly, so that few samples tell about the sampler."""
    half = draw(n // 2, 1, 1, dtype=torch.float64)
    noise = torch.cat([half, -half])
    return noise / noise.std(correction=0)


@pytest.mark.parametrize(
    ("process", "name"), [(Diffusion(), "ddim"), (Diffusion(), "ddpm"), (Flow(), "euler")]
)
def test_modes_keep_their_mass(process: Process, name: str):
    data, x = Mixture((-1.0, 0.1, 1.0), (0.15, 0.05, 0.8), 0.05), antithetic(8000)
    sampler = make_sampler(process, name, 100)
    masses = data.masses_of(
        sampler(data.denoise(process, sampler), x, torch.Generator().manual_seed(1)).float()
    )
    torch.testing.assert_close(masses, torch.tensor(data.masses), atol=0.015, rtol=0)


@every_sampler
def test_same_noise_and_generators_give_the_same_actions(process, name: str, n: int):
    sampler, x = make_sampler(process, name, n, clip=1.0), draw(B, T, A)
    kept = x.clone()
    state = torch.random.get_rng_state()
    first = sampler(network, x, NoiseSource(0).generators(B))
    assert torch.equal(
        first, make_sampler(process, name, n, clip=1.0)(network, x, NoiseSource(0).generators(B))
    )
    assert torch.equal(torch.random.get_rng_state(), state)
    assert torch.equal(x, kept)


@every_sampler
def test_an_environment_does_not_depend_on_the_batch(process, name: str, n: int):
    sampler, x, source = make_sampler(process, name, n), draw(B, T, A), NoiseSource
    together = sampler(network, x, source(0).generators(B))
    alone = sampler(network, x[[2]], source(0).generators(1, [2]))
    torch.testing.assert_close(together[[2]], alone, atol=1e-6, rtol=0)


@every_sampler
def test_threads_do_not_disturb_each_other(process, name: str, n: int):
    sampler, results, meet = make_sampler(process, name, n), {}, threading.Barrier(2)

    def work(seed: int) -> None:
        def in_turns(x: Tensor, i: int) -> Tensor:
            meet.wait(timeout=20)
            return network(x, i)

        results[seed] = sampler(in_turns, draw(B, T, A, seed=seed), NoiseSource(seed).generators(B))

    threads = [threading.Thread(target=work, args=(seed,)) for seed in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for seed in (1, 2):
        alone = sampler(network, draw(B, T, A, seed=seed), NoiseSource(seed).generators(B))
        assert torch.equal(results[seed], alone)


@every_sampler
def test_the_denoiser_is_asked_once_at_every_time_in_order(process, name: str, n: int):
    sampler, asked = make_sampler(process, name, n), []

    def counting(x: Tensor, i: int) -> Tensor:
        asked.append(i)
        return network(x, i)

    result = sampler(counting, draw(B, T, A), NoiseSource(0).generators(B))
    assert asked == list(range(len(sampler.times)))
    assert result.shape == (B, T, A)
    assert result.dtype == torch.float32


@pytest.mark.parametrize(
    ("process", "name", "n"), [case for case in EVERY if case[1] not in ("midpoint", "rk4")]
)
def test_consistent_clipping_bounds_the_actions(process, name: str, n: int):
    sampler = make_sampler(process, name, n, clip=0.5)
    assert sampler(network, draw(B, T, A), NoiseSource(0).generators(B)).abs().max() <= 0.5 + 1e-6


def test_two_steps_predict_from_nothing_and_then_from_their_shrunken_prediction():
    seen = []

    def denoise(x: Tensor, i: int) -> Tensor:
        seen.append(x)
        return x + 1 + i

    result = make_sampler(TwoStep(), "two_step", 2)(denoise, draw(B, T, A))
    assert torch.equal(seen[0], torch.zeros(B, T, A))
    torch.testing.assert_close(seen[1], torch.full((B, T, A), 0.9))
    torch.testing.assert_close(result, torch.full((B, T, A), 2.9))


@pytest.mark.parametrize(
    ("process", "name", "n", "strength", "expected"),
    [
        (Diffusion(), "ddim", 10, 0.5, [50, 40, 30, 20, 10, 0]),
        (Diffusion(), "ddpm", 10, 0.01, [0]),
        (Diffusion(), "dpm++", 10, 0.3, [28, 18, 8]),
        (Flow(), "euler", 10, 0.3, [0.7, 0.8, 0.9]),
        (Flow(), "euler", 10, 0.01, [0.9]),
        (Flow(), "midpoint", 4, 0.5, [0.5, 0.625, 0.75, 0.875]),
    ],
    ids=lambda value: str(value)[:8],
)
def test_strength_starts_at_the_nearest_level(process, name: str, n: int, strength: float, expected):
    times = make_sampler(process, name, n, strength=strength).times
    assert times.tolist() == pytest.approx(expected)


@pytest.mark.parametrize(
    ("process", "name", "n"), [(Diffusion(), "ddim", 50), (Diffusion(), "dpm++", 25), (Flow(), "heun", 50)]
)
def test_noised_actions_come_back_from_the_middle(process, name: str, n: int):
    data = Gaussian(0.7, 0.4)
    sampler = make_sampler(process, name, n, strength=0.4)
    actions = 0.7 + 0.4 * antithetic(20_000)
    noise = antithetic(20_000)[torch.randperm(20_000, generator=torch.Generator().manual_seed(0))]
    x = process.noised(actions, noise, sampler.times[0].double())
    result = sampler(data.denoise(process, sampler), x)
    assert result.mean().item() == pytest.approx(0.7, abs=0.007)
    assert result.std().item() == pytest.approx(0.4, rel=0.04)
    assert torch.corrcoef(torch.stack([result.flatten(), actions.flatten()]))[0, 1] > 0.3


def test_drawing_without_generators_is_refused():
    sampler = make_sampler(Diffusion(), "ddpm", 10)
    with pytest.raises(ValueError, match="pass it a generator for each environment"):
        sampler(network, draw(B, T, A))
    with pytest.raises(ValueError, match=r"shorter|longer"):
        sampler(network, draw(B, T, A), NoiseSource(0).generators(2))


@pytest.mark.parametrize(
    ("process", "name", "n", "settings", "message"),
    [
        ("ddqm", "ddim", 10, {}, "unknown process 'ddqm'; choose one of: ddpm, flow, two_step"),
        ("ddpm", "euler", 10, {}, "unknown sampler for ddpm 'euler'; choose one of: ddim, ddpm, dpm\\+\\+"),
        (
            "flow",
            "ddim",
            10,
            {},
            "unknown sampler for flow 'ddim'; choose one of: euler, midpoint, heun, rk4",
        ),
        ("ddpm", "ddim", 0, {}, "num_inference_steps must be at least 1, but is 0"),
        ("ddpm", "ddim", 101, {}, "num_inference_steps, 101, is above num_train_timesteps, 100"),
        ("ddpm", "ddim", 1, {}, "one step of ddim with leading spacing .* use timestep spacing 'trailing'"),
        ("ddpm", "dpm++", 51, {}, "dpm\\+\\+ with 51 of 100 .* use at most 50 steps, or ddim"),
        (
            "ddpm",
            "dpm++",
            10,
            {"spacing": "leading"},
            "dpm\\+\\+ has trailing timestep spacing, not 'leading'",
        ),
        ("ddpm", "ddim", 10, {"spacing": "even"}, "unknown timestep spacing 'even'; choose one of: leading"),
        ("flow", "euler", 10, {"spacing": "leading"}, "euler has no timestep spacing, but it is 'leading'"),
        (
            "flow",
            "euler",
            10,
            {"clip_mode": "lerobot"},
            "clip_mode 'lerobot' is for ddim and ddpm; for euler",
        ),
        ("ddpm", "ddim", 10, {"clip_mode": "hard"}, "unknown clip_mode 'hard'; choose one of: consistent, l"),
        ("flow", "heun", 10, {"strength": 0.0}, "strength must be above 0 and at most 1, but is 0.0"),
        ("flow", "heun", 10, {"strength": 1.5}, "strength must be above 0 and at most 1, but is 1.5"),
        ("two_step", "two_step", 3, {}, "two_step makes 2 steps, but num_inference_steps is 3"),
        ("two_step", "two_step", 2, {"strength": 0.5}, "two_step does not start from noised actions"),
    ],
)
def test_impossible_settings_are_refused(process: str, name: str, n: int, settings, message: str):
    with pytest.raises(ConfigurationError, match=message):
        check_sampler(process, name, n, **settings)


def test_making_a_sampler_checks_its_settings_against_the_process():
    with pytest.raises(ConfigurationError, match="11, is above num_train_timesteps, 10"):
        make_sampler(Diffusion(num_train_timesteps=10), "ddim", 11)
    with pytest.raises(ConfigurationError, match="dpm\\+\\+ with 6 of 10"):
        make_sampler(Diffusion(num_train_timesteps=10), "dpm++", 6)
