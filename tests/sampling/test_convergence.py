"""How good samplers are with perfect denoisers."""

import math
from collections.abc import Sequence
from itertools import pairwise

import pytest
import torch
from oracles import Gaussian, Mixture
from processes import make_diffusion, make_flow
from torch import Tensor

from lerobot_act_chunking.sampling.process import Process
from lerobot_act_chunking.sampling.samplers import make_sampler


def draw(*shape: int, seed: int = 0, dtype: torch.dtype = torch.float32) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def orders(errors: Sequence[float]) -> list[float]:
    """Observed orders of convergence, each from one error to the next, with twice the steps."""
    return [math.log2(coarse / fine) for coarse, fine in pairwise(errors)]


FLOW_ORDERS = pytest.mark.parametrize(
    ("name", "order"), [("euler", 1), ("midpoint", 2), ("heun", 2), ("rk4", 4)]
)


@FLOW_ORDERS
def test_order_of_flow_solvers(name: str, order: int):
    """With their special last step, on a field that is not linear; the reference has 256 steps of rk4."""
    data, x, flow = Mixture((-0.5, 0.7), (0.4, 0.6), 0.4), draw(200, 1, 1, dtype=torch.float64), make_flow()

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
        sampler = make_sampler(make_flow(), name, n)
        result = sampler(data.denoise(make_flow(), sampler), x)
        errors.append((result - data.solution(make_flow(), sampler, x)).abs().max().item())
    assert orders(errors)[-1] > order - 0.1


@pytest.mark.parametrize(("name", "lowest"), [("ddim", 0.9), ("dpm++", 1.8)])
def test_order_of_diffusion_solvers(name: str, lowest: float):
    """Half way, against the exact solution: towards both ends no number of steps makes the steps in the log
    of alpha / sigma small, and the errors of the last few, which differ in sign, hide the order."""
    process, data = make_diffusion(num_train_timesteps=4000), Gaussian(0.3, 0.5)
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
    data, x, process, errors = Gaussian(0.3, 0.5), draw(200, 1, 1, dtype=torch.float64), make_diffusion(), {}
    for name in ("ddim", "dpm++"):
        sampler = make_sampler(process, name, 10, spacing="trailing")
        result = sampler(data.denoise(process, sampler), x)
        errors[name] = (result - data.solution(process, sampler, x)).abs().max().item()
    assert errors["dpm++"] < errors["ddim"] / 2


@pytest.mark.parametrize(
    ("process", "name", "n", "tolerance"),
    [
        # First-order samplers lose variance, half as much with twice the steps; that of ddpm is sampled.
        (make_diffusion(), "ddim", 100, 0.03),
        (make_flow(), "euler", 100, 0.03),
        (make_diffusion(), "ddpm", 100, 0.06),
        (make_diffusion(num_train_timesteps=1000), "ddim", 1000, 0.01),
        (make_diffusion(num_train_timesteps=1000), "ddpm", 1000, 0.02),
        (make_flow(), "euler", 400, 0.01),
        (make_diffusion(), "dpm++", 20, 0.01),
        (make_flow(), "rk4", 5, 0.01),
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
    ("process", "name"), [(make_diffusion(), "ddim"), (make_diffusion(), "ddpm"), (make_flow(), "euler")]
)
def test_modes_keep_their_mass(process: Process, name: str):
    data, x = Mixture((-1.0, 0.1, 1.0), (0.15, 0.05, 0.8), 0.05), antithetic(8000)
    sampler = make_sampler(process, name, 100)
    masses = data.masses_of(
        sampler(data.denoise(process, sampler), x, torch.Generator().manual_seed(1)).float()
    )
    torch.testing.assert_close(masses, torch.tensor(data.masses), atol=0.015, rtol=0)


@pytest.mark.parametrize(
    ("process", "name", "n"),
    [(make_diffusion(), "ddim", 50), (make_diffusion(), "dpm++", 25), (make_flow(), "heun", 50)],
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
