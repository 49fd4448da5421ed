import threading
from collections.abc import Callable

import pytest
import torch
from processes import make_diffusion, make_flow
from torch import Tensor

from lerobot_act_chunking.sampling.noise import NoiseSource
from lerobot_act_chunking.sampling.process import Diffusion, Process, TwoStep
from lerobot_act_chunking.sampling.samplers import make_sampler

B, T, A = 3, 5, 4
EVERY = [
    *((make_diffusion(), name, 10) for name in ("ddim", "ddpm", "dpm++")),
    *((make_flow(), name, 6) for name in ("euler", "midpoint", "heun", "rk4")),
    (TwoStep("sample"), "two_step", 2),
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
    process = make_diffusion()
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
    process, x = make_diffusion(beta_schedule=schedule), draw(B, T, A)
    sampler = make_sampler(process, "ddim", n, spacing=spacing, clip=1.0)
    theirs = ddim(process, timestep_spacing=spacing, clip_sample=True)
    expected = by_diffusers(theirs, n, x, network, use_clipped_model_output=True)
    torch.testing.assert_close(sampler(network, x), expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("n", [10, 25])
def test_lerobots_clipping_keeps_the_direction_of_the_network(n: int):
    process, x = make_diffusion(), draw(B, T, A)
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
        *((make_diffusion(), "ddim", 32, spacing) for spacing in ("leading", "trailing", "linspace")),
        (make_diffusion(), "dpm++", 16, None),
        *((make_flow(), name, 7, None) for name in ("euler", "midpoint", "heun", "rk4")),
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
    process, x = make_diffusion(), draw(B, T, A)
    theirs = ddpm(process, timestep_spacing=spacing, clip_sample=True)
    expected = by_diffusers(theirs, n, x, network, generator=torch.Generator().manual_seed(3))
    ours = make_sampler(process, "ddpm", n, spacing=spacing, clip=1.0)
    torch.testing.assert_close(
        ours(network, x, torch.Generator().manual_seed(3)), expected, atol=5e-6, rtol=0
    )


def test_ddpm_takes_a_generator_for_each_row_as_diffusers_does():
    process, x = make_diffusion(), draw(B, T, A)
    expected = by_diffusers(
        ddpm(process, clip_sample=False), 10, x, network, generator=NoiseSource(5).generators(B)
    )
    ours = make_sampler(process, "ddpm", 10)(network, x, NoiseSource(5).generators(B))
    torch.testing.assert_close(ours, expected, atol=2e-6, rtol=0)


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
@pytest.mark.parametrize("n", [1, 2, 3, 10, 16, 20, 50])
def test_dpm_solver_is_that_of_diffusers(n: int):
    process, x = make_diffusion(), draw(B, T, A)
    expected = by_diffusers(dpm(process), n, x, network)
    assert expected.isfinite().all()
    torch.testing.assert_close(make_sampler(process, "dpm++", n)(network, x), expected, atol=2e-6, rtol=0)


def test_a_flow_by_euler_follows_the_velocity():
    x = start = draw(B, T, A)
    for i in range(6):
        x = x + (network(x, i) - x) / (1 - i / 6) / 6
    sampler = make_sampler(make_flow(), "euler", 6)
    torch.testing.assert_close(sampler(network, start), x, atol=1e-6, rtol=0)
    assert sampler.times.tolist() == pytest.approx([0, 1 / 6, 2 / 6, 3 / 6, 4 / 6, 5 / 6])


@pytest.mark.parametrize(("name", "per_step", "last"), [("midpoint", 2, 2), ("heun", 2, 1), ("rk4", 4, 3)])
def test_no_evaluation_of_a_flow_lies_at_its_end(name: str, per_step: int, last: int):
    for n in (1, 2, 5):
        times = make_sampler(make_flow(), name, n).times
        assert len(times) == per_step * (n - 1) + last
        assert times.max() < 1
        assert times[0] == 0


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

    result = make_sampler(TwoStep("sample"), "two_step", 2)(denoise, draw(B, T, A))
    assert torch.equal(seen[0], torch.zeros(B, T, A))
    torch.testing.assert_close(seen[1], torch.full((B, T, A), 0.9))
    torch.testing.assert_close(result, torch.full((B, T, A), 2.9))


@pytest.mark.parametrize(
    ("process", "name", "n", "strength", "expected"),
    [
        (make_diffusion(), "ddim", 10, 0.5, [50, 40, 30, 20, 10, 0]),
        (make_diffusion(), "ddpm", 10, 0.01, [0]),
        (make_diffusion(), "dpm++", 10, 0.3, [28, 18, 8]),
        (make_flow(), "euler", 10, 0.3, [0.7, 0.8, 0.9]),
        (make_flow(), "euler", 10, 0.01, [0.9]),
        (make_flow(), "midpoint", 4, 0.5, [0.5, 0.625, 0.75, 0.875]),
    ],
    ids=lambda value: str(value)[:8],
)
def test_strength_starts_at_the_nearest_level(process, name: str, n: int, strength: float, expected):
    times = make_sampler(process, name, n, strength=strength).times
    assert times.tolist() == pytest.approx(expected)


def test_drawing_without_generators_is_refused():
    sampler = make_sampler(make_diffusion(), "ddpm", 10)
    with pytest.raises(ValueError, match="pass it a generator for each environment"):
        sampler(network, draw(B, T, A))
    with pytest.raises(ValueError, match=r"shorter|longer"):
        sampler(network, draw(B, T, A), NoiseSource(0).generators(2))
