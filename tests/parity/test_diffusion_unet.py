"""`Unet1d` with the weights of LeRobot's diffusion U-Net: same outputs and gradients, FiLM split or not."""

from copy import deepcopy
from dataclasses import dataclass
from itertools import product

import pytest
import torch
from diffusion_weights import convert
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
from lerobot.policies.diffusion.modeling_diffusion import (
    DiffusionConditionalUnet1d,
    DiffusionSinusoidalPosEmb,
)
from torch import Tensor

from lerobot_act_chunking.nn.condition import Condition
from lerobot_act_chunking.nn.denoisers import short_conv
from lerobot_act_chunking.nn.denoisers.time import StepEmbedding
from lerobot_act_chunking.nn.denoisers.unet1d import SIZES, Unet1d

T, A, G, TIME_DIM = 24, 4, 13, 12
CASES = list(product([(16, 32, 48), (32, 16), (24,)], (True, False), (0, 1, 2)))


@dataclass
class Pair:
    theirs: DiffusionConditionalUnet1d
    ours: Unet1d

    def double(self) -> "Pair":
        return Pair(self.theirs.double(), self.ours.double())


def make_pair(down_dims: tuple[int, ...], film_scale: bool, seed: int) -> Pair:
    torch.manual_seed(seed)
    config = DiffusionConfig(
        output_features={"action": PolicyFeature(FeatureType.ACTION, (A,))},
        device="cpu",
        horizon=T,
        down_dims=down_dims,
        diffusion_step_embed_dim=TIME_DIM,
        use_film_scale_modulation=film_scale,
    )
    theirs = DiffusionConditionalUnet1d(config, global_cond_dim=G)
    for parameter in theirs.parameters():
        if parameter.ndim == 1:  # group norms start at one and zero, which would hide mistakes
            parameter.data += 0.1 * torch.randn_like(parameter)
    ours = Unet1d(
        action_dim=A,
        condition_dim=G,
        time_embedding=StepEmbedding(TIME_DIM),
        time_dim=TIME_DIM,
        down_dims=down_dims,
        kernel_size=config.kernel_size,
        n_groups=config.n_groups,
        film_scale=film_scale,
    )
    ours.load_state_dict(converted(theirs.state_dict(), down_dims), strict=True)
    return Pair(theirs, ours)


def converted(entries: dict[str, Tensor], down_dims: tuple[int, ...]) -> dict[str, Tensor]:
    return convert(entries, n_levels=len(down_dims), time_dim=TIME_DIM)


def inputs(batch_size: int, dtype: torch.dtype = torch.float32) -> tuple[Tensor, Tensor, Tensor]:
    x, condition = torch.randn(batch_size, T, A, dtype=dtype), torch.randn(batch_size, G, dtype=dtype)
    return x, torch.randint(100, (batch_size,)), condition


def answer(ours: Unet1d, x: Tensor, steps: Tensor, condition: Tensor) -> Tensor:
    return ours(x, ours.modulate(steps.to(x)), ours.observe(Condition(vector=condition)))


@pytest.fixture(
    params=CASES, ids=lambda c: f"{'-'.join(map(str, c[0]))}-{'scale' if c[1] else 'shift'}-{c[2]}"
)
def case(request):
    return request.param


@pytest.fixture(params=[False, True], ids=["convolutions", "products"])
def as_products(request, monkeypatch):
    """Both ways to convolve."""
    monkeypatch.setattr(short_conv, "MANY_WEIGHTS", 0 if request.param else 10**9)
    monkeypatch.setattr(short_conv, "FEW_POSITIONS", 10**9)


@pytest.mark.usefixtures("as_products")
@pytest.mark.parametrize("batch_size", [1, 3])
def test_answers_are_equal_but_for_rounding(case, batch_size, monkeypatch):
    """In float32 both round: neither is much further from the float64 answer than the other."""
    pair = make_pair(*case)
    x, steps, condition = inputs(batch_size)
    exact, embedding = deepcopy(pair.ours).double(), pair.ours.time_mlp[0]
    monkeypatch.setattr(exact.time_mlp[0], "forward", lambda time: embedding(time.float()).double())
    truth = answer(exact, x.double(), steps, condition.double())
    theirs = pair.theirs(x, steps, condition)
    ours = answer(pair.ours, x, steps, condition)
    assert (ours - truth).norm() <= 3 * (theirs - truth).norm()
    assert (theirs - truth).norm() <= 3e-6 * truth.norm()


@pytest.mark.usefixtures("as_products")
def test_answers_and_gradients_are_equal_in_float64(case, monkeypatch):
    # LeRobot's embedding of integer steps is float32 whatever the weights are; ours is checked below.
    pair = make_pair(*case).double()
    embedding = pair.ours.time_mlp[0]
    monkeypatch.setattr(pair.theirs.diffusion_step_encoder[0], "forward", lambda t: embedding(t.double()))
    x, steps, condition = inputs(3, torch.float64)
    results = []
    for call in (pair.theirs, lambda *args: answer(pair.ours, *args)):
        seen, observed = x.clone().requires_grad_(), condition.clone().requires_grad_()
        out = call(seen, steps, observed)
        out.square().sum().backward()
        results.append((out, seen.grad, observed.grad))
    torch.testing.assert_close(results[1], results[0], rtol=0, atol=1e-11)
    torch.testing.assert_close(results[1][0], results[0][0], rtol=0, atol=1e-12)
    gradients = {name: parameter.grad for name, parameter in pair.theirs.named_parameters()}
    gradients = converted(gradients, case[0])
    for name, parameter in pair.ours.named_parameters():
        torch.testing.assert_close(parameter.grad, gradients.pop(name), rtol=1e-9, atol=1e-11)
    assert not gradients


def test_gradients_are_equal_in_float32(case):
    pair = make_pair(*case)
    x, steps, condition = inputs(3)
    pair.theirs(x, steps, condition).square().mean().backward()
    answer(pair.ours, x, steps, condition).square().mean().backward()
    gradients = converted({n: p.grad for n, p in pair.theirs.named_parameters()}, case[0])
    for name, parameter in pair.ours.named_parameters():
        torch.testing.assert_close(parameter.grad, gradients[name], rtol=0, atol=1e-6)


@pytest.mark.parametrize("film_scale", [True, False])
def test_a_table_over_steps_and_one_observation_give_every_blocks_modulation(film_scale):
    pair = make_pair((16, 32, 48), film_scale, 0)
    steps, condition = torch.arange(90, -1, -10), torch.randn(3, G)
    table, observed = pair.ours.modulate(steps.float()), pair.ours.observe(Condition(vector=condition))
    seen: list[Tensor] = []
    for name, module in pair.theirs.named_modules():
        if name.endswith("cond_encoder"):
            module.register_forward_hook(lambda *args: seen.append(args[-1]))
    for i, step in enumerate(steps):
        seen.clear()
        pair.theirs(torch.randn(3, T, A), step.expand(3), condition)
        actual = table[i : i + 1] + observed.modulation
        torch.testing.assert_close(actual, torch.cat(seen, dim=1), rtol=0, atol=1e-6)


def test_step_embedding_is_lerobots():
    steps = torch.arange(100)
    expected = DiffusionSinusoidalPosEmb(TIME_DIM)(steps)
    torch.testing.assert_close(StepEmbedding(TIME_DIM)(steps.float()), expected, rtol=0, atol=0)


def test_the_largest_size_is_lerobots_default():
    assert SIZES["XL"] == DiffusionConfig(device="cpu").down_dims
