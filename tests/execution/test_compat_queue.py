"""LeRobot 0.7 drops queued actions when the instruction changes: it calls ``clear`` on what holds them."""

import numpy as np
import pytest
import torch
from execution_cases import B, Stream, T, rollout

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.execution.executor import ChunkExecutor

MODES = {
    "open_loop": {},
    "receding": {"replan_interval": 2},
    "ensemble": {"replan_interval": 2, "temporal_ensemble_coeff": 0.1},
    "late": {
        "execution": "ensemble",
        "replan_interval": 2,
        "temporal_ensemble_coeff": 0.1,
        "latency_steps": 2,
    },
    "crossfade": {"replan_interval": 2, "crossfade_steps": 2},
    "coherence": {"replan_interval": 2, "n_samples": 2},
    "cosine": {"execution": "adaptive", "replan_interval": 1, "adaptive_kernel": "cosine"},
    "gate": {"execution": "adaptive", "replan_interval": 1, "adaptive_kernel": "gate", "adaptive_scale": 1.0},
}
FORGETFUL = [name for name in MODES if name not in ("cosine", "gate")]  # nothing is learned from the rollout


def executor_for(mode):
    return ChunkExecutor(ExecutionSettings(T, **{"execution": mode, **MODES[mode]}))


def stream_for(mode):
    return Stream(samples=(2,) if mode == "coherence" else ())


def continued(executor, stream, n_steps):
    """Actions of the steps that follow those of `rollout`."""
    actions = []
    for stream.step in range(executor.n_steps, executor.n_steps + n_steps):
        actions.append(executor.step(stream, B))
    return torch.stack(actions)


@pytest.mark.parametrize("resets", [{}, {4: [1]}], ids=["in step", "out of step"])
@pytest.mark.parametrize("cleared_at", [1, 3, 7, 12])
@pytest.mark.parametrize("mode", FORGETFUL)
def test_what_follows_is_what_a_fresh_executor_does_with_the_same_predictions(mode, cleared_at, resets):
    executor, stream = executor_for(mode), stream_for(mode)
    rollout(executor, stream, cleared_at, resets)
    executor.clear()
    later = stream_for(mode)
    later.chunks = later.chunks[cleared_at:]
    actions = continued(executor, stream, 20)
    torch.testing.assert_close(actions, rollout(executor_for(mode), later, 20), rtol=0, atol=1e-12)


@pytest.mark.parametrize("mode", MODES)
def test_the_next_action_is_that_of_a_new_prediction_for_every_environment(mode):
    executor, stream = executor_for(mode), stream_for(mode)
    rollout(executor, stream, 9, {3: [1]})
    executor.clear()
    assert len(executor) == 0
    action = continued(executor, stream, 1)[0]
    assert stream.calls[-1] == (9, [0, 1, 2])
    chunks = stream.chunks[9] if mode != "coherence" else stream.chunks[9, 0]
    torch.testing.assert_close(action, chunks[:, 0], rtol=0, atol=1e-12)


def test_time_goes_on_and_what_is_typical_stays():
    executor, stream = executor_for("gate"), stream_for("gate")
    rollout(executor, stream, 13)
    typical = executor.arrays._timeline._disagreements.copy()
    assert not np.isnan(typical).all()
    executor.clear()
    assert executor.n_steps == 13
    assert np.array_equal(executor.arrays._timeline._disagreements, typical, equal_nan=True)


@pytest.mark.parametrize("mode", MODES)
def test_before_the_first_prediction_there_is_nothing_to_drop(mode):
    executor = executor_for(mode)
    executor.clear()
    fresh = rollout(executor_for(mode), stream_for(mode), 8)
    assert torch.equal(rollout(executor, stream_for(mode), 8), fresh)


@pytest.mark.parametrize("mode", MODES)
def test_of_some_environments_the_others_go_on_as_they_were(mode):
    executors, streams = [executor_for(mode) for _ in range(3)], [stream_for(mode) for _ in range(3)]
    for executor, stream in zip(executors, streams, strict=True):
        rollout(executor, stream, 9, {3: [1]})
    some, every, none = executors
    some.clear(torch.tensor([1]))
    every.clear()
    actions = [continued(*each, 1)[0] for each in zip((some, every, none), streams, strict=True)]
    torch.testing.assert_close(actions[0][1], actions[1][1], rtol=0, atol=1e-12)
    torch.testing.assert_close(actions[0][[0, 2]], actions[2][[0, 2]], rtol=0, atol=1e-12)
