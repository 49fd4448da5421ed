import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from lerobot.policies.act.modeling_act import ACTTemporalEnsembler

from lerobot_act_chunking.execution.ensemble import TemporalEnsemble, ensemble_gains
from lerobot_act_chunking.execution.executor import ChunkExecutor

B, A = 3, 4


def chunks(n, chunk_size, dtype=torch.float64):
    return torch.randn(n, B, chunk_size, A, generator=torch.Generator().manual_seed(0), dtype=dtype)


def execute(ensemble, predictions, n_action_steps, n_steps):
    executor, source = ChunkExecutor(n_action_steps, ensemble), iter(predictions)
    return torch.stack([executor.step(lambda: next(source), B) for _ in range(n_steps)])


def brute_force(predictions, chunk_size, n_action_steps, coeff, n_steps):
    """Keep every chunk; average at each step over all that cover it, weights from the oldest on."""
    actions = []
    for t in range(n_steps):
        starts = [s for s in range(0, t + 1, n_action_steps) if t - s < chunk_size]
        ages = torch.tensor([s - starts[0] for s in starts], dtype=torch.float64)
        weights = torch.exp(-coeff * ages)
        votes = torch.stack([predictions[s // n_action_steps][:, t - s] for s in starts])
        actions.append((weights[:, None, None] * votes).sum(0) / weights.sum())
    return torch.stack(actions)


@settings(max_examples=60, deadline=None)
@given(
    chunk_size=st.integers(1, 12),
    n_action_steps=st.integers(1, 12),
    coeff=st.sampled_from([0.0, 0.01, 0.5, -0.01, -0.5]),
    n_steps=st.integers(1, 40),
)
def test_equals_brute_force(chunk_size, n_action_steps, coeff, n_steps):
    n_action_steps = min(n_action_steps, chunk_size)
    predictions = chunks(math.ceil(n_steps / n_action_steps), chunk_size)
    ensemble = TemporalEnsemble(chunk_size, n_action_steps, coeff)
    torch.testing.assert_close(
        execute(ensemble, predictions, n_action_steps, n_steps),
        brute_force(predictions, chunk_size, n_action_steps, coeff, n_steps),
        rtol=0,
        atol=1e-12,
    )


@pytest.mark.parametrize("coeff", [0.01, 0.0, -0.05])
def test_equals_lerobots_when_replanning_at_every_step(coeff):
    predictions = chunks(300, 20, torch.float32)
    theirs = ACTTemporalEnsembler(coeff, 20)
    expected = torch.stack([theirs.update(chunk) for chunk in predictions])
    ours = execute(TemporalEnsemble(20, 1, coeff), predictions, 1, 300)
    torch.testing.assert_close(ours, expected, rtol=0, atol=5e-6)


def test_positive_coefficients_favour_the_oldest_chunk():
    predictions = torch.stack([torch.zeros(B, 5, A), torch.ones(B, 5, A)])
    old, new = (execute(TemporalEnsemble(5, 1, c), predictions, 1, 2)[1].mean() for c in (1.0, -1.0))
    assert old == pytest.approx(math.exp(-1) / (1 + math.exp(-1)))
    assert new == pytest.approx(1 / (1 + math.exp(-1)))


def test_zero_actions_are_votes():
    predictions = torch.stack([torch.full((B, 5, A), 4.0), torch.zeros(B, 5, A)])
    assert execute(TemporalEnsemble(5, 1, 0.0), predictions, 1, 2)[1].unique().item() == 2.0


@pytest.mark.parametrize("coeff", [0.0, 10.0, -10.0])
def test_no_coefficient_overflows(coeff):
    gains = ensemble_gains(1000, coeff)
    assert torch.isfinite(gains).all()
    assert ((gains >= 0) & (gains <= 1)).all()
    assert gains[0] == 1


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_stays_finite(dtype):
    out = execute(TemporalEnsemble(50, 1, 0.01), chunks(120, 50, dtype), 1, 120)
    assert out.dtype == dtype
    assert torch.isfinite(out).all()


def test_reset_equals_fresh():
    predictions = chunks(30, 8)
    ensemble = TemporalEnsemble(8, 3, 0.1)
    execute(ensemble, predictions, 3, 11)
    ensemble.reset()
    fresh = TemporalEnsemble(8, 3, 0.1)
    assert torch.equal(execute(ensemble, predictions, 3, 20), execute(fresh, predictions, 3, 20))


def test_chunks_are_not_changed():
    chunk = chunks(1, 8)[0]
    before = chunk.clone()
    ensemble = TemporalEnsemble(8, 1, 0.1)
    ensemble.add(chunk)
    ensemble.pop()
    ensemble.add(chunk)
    assert torch.equal(chunk, before)


def test_a_step_without_prediction_is_an_error():
    ensemble = TemporalEnsemble(2, 1, 0.0)
    with pytest.raises(IndexError, match="no prediction covers this step"):
        ensemble.pop()
    ensemble.add(torch.zeros(B, 2, A))
    ensemble.pop(), ensemble.pop()
    with pytest.raises(IndexError, match="no prediction covers this step"):
        ensemble.pop()
