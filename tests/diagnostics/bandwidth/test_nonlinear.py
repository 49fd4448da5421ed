import pytest

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.bandwidth.closed_form import closed_form, filter_for
from lerobot_act_chunking.diagnostics.bandwidth.nonlinear import STEP_SIZES, measure_steps


@pytest.mark.parametrize("kernel", ["gate", "gaussian"])
def test_distance_kernels_answer_large_steps_at_once_and_small_ones_slowly(kernel):
    small, middle, large = measure_steps(
        ExecutionSettings(40, "adaptive", replan_interval=2, adaptive_kernel=kernel)
    )
    assert (small.size, middle.size, large.size) == STEP_SIZES
    assert small.settle_90_steps > 20
    assert large.settle_90_steps <= 2
    assert len(large.shares) == 41
    assert large.shares[-1] == pytest.approx(1, abs=1e-3)


def test_coherence_keeps_to_its_plan_through_small_steps():
    small, _, large = measure_steps(ExecutionSettings(40, "coherence", replan_interval=5, n_samples=4))
    assert small.shares[0] < large.shares[0]
    assert large.settle_90_steps <= 5


def test_is_reproducible():
    settings = ExecutionSettings(12, "adaptive", replan_interval=3)
    assert measure_steps(settings) == measure_steps(settings)
    assert measure_steps(settings) != measure_steps(settings, seed=1)


@pytest.mark.parametrize("mode", ["adaptive", "coherence"])
def test_there_is_no_invented_formula(mode):
    settings = ExecutionSettings(12, mode, replan_interval=3)
    assert filter_for(settings) is None
    assert closed_form(settings, 50.0) is None


def test_long_chunks_stay_within_memory():
    steps = measure_steps(ExecutionSettings(500, "adaptive", replan_interval=100))
    assert len(steps[0].shares) == 501
