"""Adaptive ensembling beside a slow one, and what each kernel is for."""

import math
import statistics
import warnings

import numpy as np
import pytest
import torch
from execution_cases import A, B, Stream, T, rollout

from act_chunking_runtime.adaptive import FEWEST, MEMORY, AdaptiveEnsemble
from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.execution.executor import ChunkExecutor

KERNELS = ("cosine", "gaussian", "gate")


@pytest.fixture(params=KERNELS)
def kernel(request):
    return request.param


def adaptive(kernel, chunk_size=T, interval=1, **fields):
    return ChunkExecutor(
        ExecutionSettings(chunk_size, "adaptive", replan_interval=interval, adaptive_kernel=kernel, **fields)
    )


class OneEnvironment:
    """Every older chunk kept whole, every step of the plan worked out alone."""

    def __init__(self, settings):
        self.settings, self.used = settings, settings.n_action_steps
        self.chunks, self.disagreements, self.plan = [], [], {}
        self.last = torch.zeros(A, dtype=torch.float64)

    def add(self, now, chunk):
        first = now + self.settings.latency_steps
        for step in range(now, first):
            self.plan.setdefault(step, chunk[step - now])
        older = [(start, old) for start, old in self.chunks if start + self.used > first]
        distances = [self.distance(first, start, old, now, chunk) for start, old in older]
        known = self.disagreements[-MEMORY:]
        typical = statistics.median_low(known) if len(known) >= FEWEST else math.inf
        tolerance = self.settings.adaptive_scale * typical
        for step in range(first, now + self.used):
            self.plan[step] = self.blend(step, now, chunk, older, distances, tolerance)
        if distances:
            self.disagreements.append(statistics.median_low(distances))
        if self.settings.adaptive_kernel == "gate" and distances and min(distances) > tolerance:
            self.chunks.clear()
        self.chunks.append((now, chunk))

    def distance(self, first, start, old, now, chunk):
        steps = range(first, start + self.used)
        squares = [(old[step - start] - chunk[step - now]).square().mean() for step in steps]
        return math.sqrt(sum(squares) / len(squares))

    def blend(self, step, now, chunk, older, distances, tolerance):
        newest = chunk[step - now]
        votes, weights = [newest], [self.agreement(newest, newest, 0.0, tolerance)]
        for (start, old), distance in zip(older, distances, strict=True):
            if step < start + self.used:
                base = math.exp(self.settings.weight_growth * (now - start))
                votes.append(old[step - start])
                weights.append(base * self.agreement(votes[-1], newest, distance, tolerance))
        return sum(w * vote for w, vote in zip(weights, votes, strict=True)) / sum(weights)

    def agreement(self, vote, newest, distance, tolerance):
        kernel, scale = self.settings.adaptive_kernel, self.settings.adaptive_scale
        if kernel == "cosine":
            ours, theirs = vote - self.last, newest - self.last
            return math.exp(scale * float(ours @ theirs / (ours.norm() * theirs.norm())))
        if kernel == "gaussian":
            return math.exp(-float((vote - newest).square().mean()) / (2 * tolerance**2))
        return float(distance <= tolerance)

    def action(self, now):
        self.last = self.plan[now]
        return self.last


@pytest.mark.parametrize("weighting", ["act", "recency"])
@pytest.mark.parametrize(("used", "interval", "latency"), [(5, 1, 0), (7, 2, 3), (6, 4, 1), (8, 3, 2)])
def test_equals_a_slow_one(kernel, weighting, used, interval, latency):
    chosen = ExecutionSettings(
        chunk_size=9,
        execution="adaptive",
        n_action_steps=used,
        replan_interval=interval,
        latency_steps=latency,
        temporal_ensemble_coeff=0.3,
        ensemble_weighting=weighting,
        adaptive_kernel=kernel,
        adaptive_scale=1.0,
    )
    n_steps, resets = 90, {13: [1], 14: [2], 40: [0, 2]}
    stream = Stream(n_steps, chunk_size=9)
    actions = rollout(ChunkExecutor(chosen), stream, n_steps, resets)
    slow, asked = [OneEnvironment(chosen) for _ in range(B)], dict(stream.calls)
    for step in range(n_steps):
        for env in resets.get(step, []):
            slow[env] = OneEnvironment(chosen)
        for env in asked.get(step, []):
            slow[env].add(step, stream.chunks[step, env])
        expected = torch.stack([one.action(step) for one in slow])
        torch.testing.assert_close(actions[step], expected, rtol=0, atol=1e-12)


def noisy(n_steps, level):
    """A plan that all chunks share but for some noise; ``level`` says where it is at each step."""
    stream = Stream(n_steps, chunk_size=20, dtype=torch.float32)
    stream.chunks = 0.01 * stream.chunks + torch.tensor(level)[:, None, None, None]
    return stream


def test_the_gate_lets_a_disturbance_be_answered_in_one_step():
    stream = noisy(60, [0.0] * 30 + [1.0] * 30)
    gated = rollout(adaptive("gate", 20), stream, 60)
    plain = rollout(ChunkExecutor(ExecutionSettings(20, "ensemble", replan_interval=1)), stream, 60)
    assert (gated[29] - 0).abs().max() < 0.01
    assert (gated[30] - 1).abs().max() < 0.02
    assert plain[30].max() < 0.1


def test_before_and_after_it_the_gate_averages():
    stream = noisy(80, [0.0] * 30 + [1.0] * 50)
    gated = rollout(adaptive("gate", 20), stream, 80)
    plain = rollout(ChunkExecutor(ExecutionSettings(20, "ensemble", replan_interval=1)), stream, 80)
    torch.testing.assert_close(gated[:30], plain[:30])
    torch.testing.assert_close(gated[55:], plain[55:])


def test_what_was_before_a_disturbance_does_not_come_back():
    """A stray chunk would be averaged with those before it again if they had only been left out once."""
    stream = noisy(60, [0.0] * 30 + [1.0] + [0.0] * 29)
    gated = rollout(adaptive("gate", 20), stream, 60)
    assert torch.equal(gated[30:32], stream.chunks[30:32, :, 0])


def test_a_disturbance_is_answered_as_soon_as_the_chunk_is_there():
    stream = noisy(60, [0.0] * 30 + [1.0] * 30)
    gated = rollout(adaptive("gate", 20, latency_steps=4), stream, 60)
    assert gated[33].abs().max() < 0.01
    assert (gated[34] - 1).abs().max() < 0.02


def test_one_disturbed_environment_does_not_concern_the_others():
    stream, calm = noisy(60, [0.0] * 60), noisy(60, [0.0] * 60)
    stream.chunks[30:, 1] += 1
    disturbed, undisturbed = (rollout(adaptive("gate", 20), source, 60) for source in (stream, calm))
    assert torch.equal(disturbed[:, [0, 2]], undisturbed[:, [0, 2]])
    assert (disturbed[30, 1] - 1).abs().max() < 0.02


def test_the_first_chunks_are_all_accepted():
    """Nothing is typical until `FEWEST` disagreements are known."""
    level = [0.0, 5.0, -5.0, 5.0, -5.0, 5.0]
    gated = rollout(adaptive("gate", 20, adaptive_scale=1e-3), noisy(6, level), 6)
    plain = rollout(ChunkExecutor(ExecutionSettings(20, "ensemble", replan_interval=1)), noisy(6, level), 6)
    torch.testing.assert_close(gated[:5], plain[:5])
    assert torch.allclose(gated[5], torch.tensor(5.0), atol=0.02)


def test_the_cosine_is_between_changes_not_targets():
    """Far from zero, all targets point the same way; what they change need not."""
    start, ahead, back = (np.full((1, 3, 2), value) for value in (100.0, 101.0, 99.0))
    timeline = AdaptiveEnsemble(3, 0.0, "cosine", 50.0, 3)
    timeline.add(np.concatenate([start[:, :1], back[:, :2]], axis=1))
    timeline.pop()
    timeline.add(ahead)
    np.testing.assert_allclose(timeline.pop(), ahead[:, 0], rtol=1e-7)
    timeline.reset()
    timeline.add(np.concatenate([start[:, :1], ahead[:, :2] + 1], axis=1))
    timeline.pop()
    timeline.add(ahead)
    np.testing.assert_allclose(timeline.pop(), ahead[:, 0] + 0.5, rtol=1e-7)


def test_grippers_follow_the_newest_chunk_and_have_no_say(kernel):
    stream = Stream(40, n_dims=3)
    moving = Stream(40, n_dims=3)
    moving.chunks = moving.chunks[..., [0, 2]]
    held = rollout(adaptive(kernel, gripper_dims=(1,), adaptive_scale=1.0), stream, 40)
    torch.testing.assert_close(
        held[..., [0, 2]], rollout(adaptive(kernel, adaptive_scale=1.0), moving, 40), rtol=0, atol=1e-12
    )
    assert torch.equal(held[..., 1], stream.chunks[:40, :, 0, 1])


@pytest.mark.parametrize("n_dims", [1, 4])
@pytest.mark.parametrize("value", [0.0, 0.7])
def test_chunks_without_any_disagreement(kernel, n_dims, value):
    stream = Stream(30, n_dims=n_dims, dtype=torch.float32)
    stream.chunks[:20] = value
    stream.chunks[20:] = value + 1  # no distance is typical, so that any is too far
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        actions = rollout(adaptive(kernel), stream, 30)
    torch.testing.assert_close(actions[:20], torch.full_like(actions[:20], value))
    if kernel != "cosine":
        torch.testing.assert_close(actions[20:], torch.full_like(actions[20:], value + 1))
    assert actions.isfinite().all()


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_half_precision(kernel, dtype):
    stream = Stream(60, dtype=dtype)
    actions = rollout(adaptive(kernel, temporal_ensemble_coeff=10.0, gripper_dims=(0, 1, 2, 3)), stream, 60)
    assert actions.dtype == dtype
    assert actions.abs().max() <= 1
    assert rollout(adaptive(kernel, temporal_ensemble_coeff=10.0), stream, 60).abs().max() <= 1


def test_the_most_recent_disagreements_decide_what_is_typical():
    """After `MEMORY` noisier chunks, noise of that size is nothing to forget the older ones for."""
    quiet, loud = [0.0] * 20, [0.5 * (-1) ** step for step in range(MEMORY + 20)]
    stream = noisy(len(quiet + loud), quiet + loud)
    gated = rollout(adaptive("gate", 20), stream, len(quiet + loud))
    assert (gated[20] - 0.5).abs().max() < 0.02
    assert gated[-1].abs().max() < 0.2
