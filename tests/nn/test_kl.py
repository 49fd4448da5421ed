import pytest
import torch

from lerobot_act_chunking.nn.kl import KlSchedule, free_bits

B, J = 3, 4
KL = torch.tensor([[0.0, 0.3, 2.0, 0.02], [0.1, 0.1, 3.0, 0.01], [0.05, 0.5, 4.0, 0.03]])
MEANS = [0.05, 0.3, 3.0, 0.02]


def test_without_free_bits_divergences_are_summed():
    torch.testing.assert_close(free_bits(KL, 0.0), KL.sum(-1))
    estimate = torch.tensor([[-0.5], [0.2]])  # Monte-Carlo estimates may be negative
    assert torch.equal(free_bits(estimate, 0.0), estimate[:, 0])


def test_each_dimension_costs_at_least_its_free_bits():
    expected = sum(max(mean, 0.1) for mean in MEANS)
    assert free_bits(KL, 0.1).mean().item() == pytest.approx(expected)


def test_only_dimensions_above_the_floor_are_pulled():
    divergence = KL.clone().requires_grad_()
    free_bits(divergence, 0.1).mean().backward()
    assert divergence.grad is not None
    above = torch.tensor(MEANS) > 0.1
    torch.testing.assert_close(divergence.grad, above.expand(B, J) / B)


def test_no_annealing():
    assert [KlSchedule("none", 10)(step) for step in (0, 5, 100)] == [1.0] * 3


def test_linear_annealing():
    assert [KlSchedule("linear", 10)(step) for step in (0, 1, 5, 10, 11)] == [0.0, 0.1, 0.5, 1.0, 1.0]


def test_cyclical_annealing_rises_four_times():
    schedule = KlSchedule("cyclical", 80)  # cycles of 20, of which 10 rise
    factors = [schedule(step) for step in range(100)]
    assert factors[:21] == pytest.approx([step / 10 for step in range(10)] + [1.0] * 10 + [0.0])
    assert [step for step, factor in enumerate(factors) if factor == 0] == [0, 20, 40, 60]
    assert factors[80:] == [1.0] * 20


@pytest.mark.parametrize("kind", ["linear", "cyclical"])
def test_annealing_over_no_steps_is_none(kind):
    assert KlSchedule(kind, 0)(0) == 1.0
