import math
import warnings

import numpy as np
import pytest
import torch
from execution_cases import A, B, Stream, T, Votes, rollout
from hypothesis import given, settings
from hypothesis import strategies as st
from lerobot.policies.act.modeling_act import ACTTemporalEnsembler

from act_chunking_runtime.settings import ExecutionSettings
from act_chunking_runtime.timeline import TemporalEnsemble
from lerobot_act_chunking.execution.executor import ChunkExecutor

COEFFS = (0.0, 0.01, 0.5, 10.0)


def ensemble(chunk_size=T, interval=1, coeff=0.0, **settings):
    return ChunkExecutor(
        ExecutionSettings(
            chunk_size, "ensemble", replan_interval=interval, temporal_ensemble_coeff=coeff, **settings
        )
    )


@st.composite
def rhythms(draw):
    """Settings in which chunks overlap, and environments that start anew at some steps."""
    size = draw(st.integers(2, 12))
    used = draw(st.integers(2, size))
    latency = draw(st.integers(0, used - 2))
    weighting = draw(st.sampled_from(["act", "recency", "uniform"]))
    chosen = {
        "chunk_size": size,
        "execution": "ensemble",
        "n_action_steps": used,
        "replan_interval": draw(st.integers(1, used - latency - 1)),
        "latency_steps": latency,
        "temporal_ensemble_coeff": 0.0 if weighting == "uniform" else draw(st.sampled_from(COEFFS)),
        "ensemble_weighting": weighting,
    }
    batch_size = draw(st.integers(1, 4))
    envs = st.lists(st.integers(0, batch_size - 1), unique=True, min_size=1)
    return chosen, batch_size, draw(st.dictionaries(st.integers(0, 34), envs, max_size=4))


@settings(max_examples=60, deadline=None)
@given(rhythms())
def test_is_the_weighted_mean_of_all_predictions(rhythm):
    fields, batch_size, resets = rhythm
    chosen = ExecutionSettings(**fields)
    stream = Stream(35, batch_size, chosen.chunk_size)
    actions = rollout(ChunkExecutor(chosen), stream, 35, resets)
    votes = [Votes(chosen.n_action_steps, chosen.weight_growth) for _ in range(batch_size)]
    asked = dict(stream.calls)
    for step in range(35):
        for env in resets.get(step, []):
            votes[env].chunks.clear()
        for env in asked.get(step, []):
            votes[env].add(step, stream.chunks[step, env], chosen.latency_steps)
        expected = torch.stack([vote.action(step) for vote in votes])
        torch.testing.assert_close(actions[step], expected, rtol=0, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(
    growth=st.sampled_from([*COEFFS, -0.01, -0.5, -10.0]),
    used=st.integers(1, 8),
    plan=st.lists(
        st.tuples(st.lists(st.integers(0, B - 1), unique=True), st.integers(0, 4), st.booleans()), max_size=30
    ),
)
def test_any_rhythm_and_latency_with_steps_that_nothing_covers(growth, used, plan):
    """Chunks come when they come, for whom they come; ``plan`` says for whom, how late, and who is reset."""
    timeline, stream = TemporalEnsemble(used, growth), Stream(31, chunk_size=8)
    votes, usable = [Votes(used, growth) for _ in range(B)], 0
    for step, (envs, delay, reset) in enumerate([(list(range(B)), 0, False), *plan]):
        if reset and envs:
            timeline.reset(np.array(envs))
            for env in envs:
                votes[env].chunks.clear()
        usable = max(usable, step + delay)
        if envs:
            late = min(usable - step, used)
            rows = np.array(envs)
            timeline.add(
                stream.chunks[step, rows, :used].numpy(), None if len(envs) == B and step == 0 else rows, late
            )
            for env in envs:
                votes[env].add(step, stream.chunks[step, env], late)
        expected = torch.stack([vote.action(step) for vote in votes])
        torch.testing.assert_close(torch.from_numpy(timeline.pop()), expected, rtol=0, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(
    growth=st.sampled_from([*COEFFS, -0.01, -0.5]),
    used=st.integers(1, 6),
    stretches=st.lists(
        st.tuples(st.integers(0, 3), st.integers(0, 3), st.integers(1, 12)), min_size=1, max_size=4
    ),
)
def test_a_steady_rhythm_may_change_at_any_moment(growth, used, stretches):
    """Stretches of chunks for all environments: how far apart, how late, how many."""
    rhythm = [(apart, delay) for apart, delay, count in stretches for _ in range(count)]
    timeline, vote = TemporalEnsemble(used, growth), Votes(used, growth)
    stream, step, usable = Stream(len(rhythm) + 1, chunk_size=6), 0, 0
    for chunk, (apart, delay) in zip(stream.chunks, [(0, 0), *rhythm], strict=True):
        for _ in range(apart):
            torch.testing.assert_close(
                torch.from_numpy(timeline.pop()[0]), vote.action(step), rtol=0, atol=1e-12
            )
            step += 1
        usable = max(usable, step + delay)
        late = min(usable - step, used)
        timeline.add(chunk[:, :used].numpy(), None, late)
        vote.add(step, chunk[0], late)
    torch.testing.assert_close(torch.from_numpy(timeline.pop()[0]), vote.action(step), rtol=0, atol=1e-12)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("coeff", [0.01, 0.0, 0.1, -0.01, -0.1])
def test_equals_lerobots_when_replanning_at_every_step(coeff, dtype, unchecked):
    weighting = "act" if coeff >= 0 else "recency"
    stream, theirs = Stream(300, chunk_size=100, dtype=dtype), ACTTemporalEnsembler(coeff, 100)
    expected = torch.stack([theirs.update(chunk.clone()) for chunk in stream.chunks])
    ours = rollout(ensemble(100, coeff=abs(coeff), ensemble_weighting=weighting), stream, 300)
    torch.testing.assert_close(ours, expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize(("weighting", "share"), [("act", 1), ("recency", math.e), ("uniform", None)])
def test_weighting_says_whether_old_or_new_predictions_weigh_more(weighting, share):
    executor = ensemble(coeff=0.0 if share is None else 1.0, ensemble_weighting=weighting)
    executor.add(torch.zeros(B, T, A))
    executor.pop()
    executor.add(torch.ones(B, T, A))
    expected = 0.5 if share is None else share / (1 + math.e)
    assert executor.pop().unique().item() == pytest.approx(expected)


def test_zero_actions_are_votes():
    executor = ensemble()
    executor.add(torch.full((B, T, A), 4.0))
    executor.pop()
    executor.add(torch.zeros(B, T, A))
    assert executor.pop().unique().item() == 2.0


@pytest.mark.parametrize("weighting", ["act", "recency"])
@pytest.mark.parametrize("coeff", [0.0, 0.01, 1.0, 10.0])
@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16, torch.float16])
def test_stays_a_mean_of_the_predictions(coeff, weighting, dtype, unchecked):
    """Without overflow, underflow or warnings, through a start and a thousand overlapping chunks."""
    stream = Stream(1010, batch_size=1, chunk_size=1000, n_dims=1, dtype=dtype)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        actions = rollout(ensemble(1000, coeff=coeff, ensemble_weighting=weighting), stream, 1010)
    assert actions.dtype == dtype
    assert actions.abs().max() <= 1  # false for NaN, too
    if coeff == 10:
        starts = torch.arange(1010) if weighting == "recency" else (torch.arange(1010) - 999).clamp(min=0)
        deciding = stream.chunks[starts, :, torch.arange(1010) - starts]
        torch.testing.assert_close(actions, deciding, rtol=0, atol=1e-4)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_half_precision_is_only_of_the_predictions(dtype):
    stream = Stream(30, chunk_size=12, dtype=dtype)
    exact = Stream(30, chunk_size=12)
    exact.chunks = stream.chunks.double()
    ours = rollout(ensemble(12, coeff=0.1), stream, 30)
    torch.testing.assert_close(ours, rollout(ensemble(12, coeff=0.1), exact, 30).to(dtype), rtol=0, atol=0)


def test_grippers_follow_the_newest_chunk():
    stream = Stream()
    free = rollout(ensemble(coeff=0.1), stream, 20)
    held = rollout(ensemble(coeff=0.1, gripper_dims=(1, 3)), stream, 20)
    assert torch.equal(held[..., [0, 2]], free[..., [0, 2]])
    assert torch.equal(held[..., [1, 3]], stream.chunks[:20, :, 0, [1, 3]])


def test_grippers_follow_the_older_chunk_until_the_newest_is_there():
    stream = Stream()
    held = rollout(ensemble(interval=2, latency_steps=1, gripper_dims=(1,)), stream, 6)
    expected = [
        stream.chunks[start, :, age, 1] for start, age in [(0, 0), (0, 1), (0, 2), (2, 1), (2, 2), (4, 1)]
    ]
    assert torch.equal(held[..., 1], torch.stack(expected))
