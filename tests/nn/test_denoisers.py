"""What holds for every denoiser."""

from dataclasses import replace

import pytest
import torch
from denoiser_cases import A, B, T, answer, condition, draw, shaken, small

from lerobot_act_chunking.nn.condition import Condition
from lerobot_act_chunking.nn.denoisers.make import DENOISERS


@pytest.fixture(params=DENOISERS)
def denoiser(request):
    torch.manual_seed(0)
    return shaken(small(request.param))


def test_answers_have_the_shape_of_the_actions(denoiser):
    assert answer(denoiser, draw(B, T, A), torch.rand(B), condition()).shape == (B, T, A)


def test_actions_time_and_observation_all_matter(denoiser):
    x, time, observed = draw(B, T, A), torch.full((B,), 0.3), condition()
    out = answer(denoiser, x, time, observed)
    for other in (
        answer(denoiser, draw(B, T, A, seed=9), time, observed),
        answer(denoiser, x, time + 0.1, observed),
        answer(denoiser, x, time, condition(seed=9)),
    ):
        assert ((out - other).flatten(1).abs().amax(1) > 1e-3).all()


def test_time_and_observation_contribute_apart(denoiser):
    """Nothing but their sum may count, or caching either would be wrong."""
    context = denoiser.observe(condition())
    of_time = denoiser.modulate(torch.rand(B))
    moved = draw(*of_time.shape, seed=5)
    torch.testing.assert_close(
        denoiser(draw(B, T, A), of_time + moved, context),
        denoiser(draw(B, T, A), of_time, replace(context, modulation=context.modulation + moved)),
        rtol=1e-4,
        atol=1e-5,
    )


def test_a_table_of_times_equals_one_time_for_each_row(denoiser):
    times = torch.tensor([0.0, 0.2, 0.9])
    table, context = denoiser.modulate(times), denoiser.observe(condition())
    for i, time in enumerate(times):
        torch.testing.assert_close(
            denoiser(draw(B, T, A), table[i : i + 1], context),
            answer(denoiser, draw(B, T, A), time.expand(B), condition()),
        )


def test_rows_do_not_depend_on_each_other(denoiser):
    x, time, observed = draw(B, T, A), torch.rand(B), condition()
    together = answer(denoiser, x, time, observed)
    for i in range(B):
        alone = Condition(observed.vector[i : i + 1], observed.tokens[i : i + 1])
        torch.testing.assert_close(
            answer(denoiser, x[i : i + 1], time[i : i + 1], alone),
            together[i : i + 1],
            rtol=1e-4,
            atol=1e-5,
        )


def test_the_order_of_actions_matters(denoiser):
    x, backwards = draw(B, T, A), torch.arange(T - 1, -1, -1)
    out = answer(denoiser, x, torch.rand(1), condition())
    reordered = answer(denoiser, x[:, backwards], torch.rand(1), condition())[:, backwards]
    assert (out - reordered).abs().max() > 1e-2


def test_every_action_sees_every_other(denoiser):
    x = draw(1, T, A).requires_grad_()
    out = answer(denoiser, x, torch.rand(1), condition(1))
    for step in (0, T - 1):
        (gradient,) = torch.autograd.grad(out[0, step].sum(), x, retain_graph=True)
        assert (gradient[0].abs().amax(1) > 0).all()


def test_contexts_repeat_sample_by_sample(denoiser):
    x, table = draw(2 * B, T, A), denoiser.modulate(torch.tensor([0.4]))
    context = denoiser.observe(condition())
    both = denoiser(x, table, context.repeat(2))
    torch.testing.assert_close(both[:B], denoiser(x[:B], table, context), rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(both[B:], denoiser(x[B:], table, context), rtol=1e-4, atol=1e-5)
    assert context.repeat(1) is context


def test_every_parameter_gets_a_gradient(denoiser):
    answer(denoiser, draw(B, T, A), torch.rand(B), condition()).square().sum().backward()
    for name, parameter in denoiser.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().max() > 0, name


def test_bfloat16_autocast(denoiser):
    x, time = draw(B, T, A), torch.full((B,), 0.3)
    expected = answer(denoiser, x, time, condition())
    with torch.autocast("cpu", torch.bfloat16):
        out = answer(denoiser, x, time, condition())
    error = (out.float() - expected).square().mean().sqrt()
    assert error < 0.1 * expected.square().mean().sqrt()
