"""Chunks that are computed beside the actions before them."""

import threading

import pytest
import torch
from execution_cases import Stream, T, rollout

from act_chunking_runtime.background import PATIENCE
from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.execution.executor import ChunkExecutor

MODES = {
    "receding": {"execution": "receding"},
    "crossfade": {"execution": "crossfade", "crossfade_steps": 2},
    "ensemble": {"execution": "ensemble", "temporal_ensemble_coeff": 0.3},
    "cosine": {"execution": "adaptive", "adaptive_kernel": "cosine"},
    "gaussian": {"execution": "adaptive", "adaptive_kernel": "gaussian"},
    "gate": {"execution": "adaptive", "adaptive_kernel": "gate"},
    "coherence": {"execution": "coherence", "n_samples": 2},
    "smoothed, a gripper": {"execution": "ensemble", "smoothing_steps": 3, "gripper_dims": (1,)},
}


def settings(**changes):
    return ExecutionSettings(2 * T, replan_interval=3, **changes)


def one_robot(**settings):
    return Stream(60, batch_size=1, chunk_size=2 * T, **settings)


def prepared(stream, delays=None):
    """Chunks of this stream that are there as soon as they are asked for."""

    def prepare(envs, delay):
        chunk = stream(envs)
        if delays is not None:
            delays.append(delay)
        return lambda: chunk

    return prepare


def wait(executor):
    """Until what is being computed is there."""
    if executor.arrays._awaited is not None:
        executor.arrays._awaited.future.result()


def late_rollout(executor, stream, n_steps, age):
    """Actions where every chunk but the first is there ``age`` steps after its observation."""
    actions, gate, asked_at = [], threading.Event(), None

    def prepare(envs, delay):
        nonlocal asked_at
        chunk, first = stream(envs), not actions
        if not first:
            asked_at = stream.step
            gate.clear()
        return lambda: chunk if first or gate.wait(10) else None

    for stream.step in range(n_steps):
        if asked_at is not None and stream.step == asked_at + age:
            gate.set()
            wait(executor)
        actions.append(executor.advance(prepare, 1))
    gate.set()
    return torch.stack(actions)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("age", [1, 3])
def test_a_chunk_that_comes_late_is_one_with_so_much_latency(mode, age):
    changes = MODES[mode]
    samples = (2,) if "n_samples" in changes else ()
    late = late_rollout(
        ChunkExecutor(settings(background=True, **changes)), one_robot(samples=samples), 45, age
    )
    expected = rollout(ChunkExecutor(settings(latency_steps=age, **changes)), one_robot(samples=samples), 45)
    torch.testing.assert_close(late, expected, rtol=0, atol=1e-14)


def test_no_step_but_the_first_waits_and_the_last_action_is_held_beyond_the_plan():
    stream, gate = one_robot(), threading.Event()
    executor = ChunkExecutor(settings(execution="receding", background=True))

    def prepare(envs, delay):
        chunk, first = stream(envs), not len(stream.calls[:-1])
        return lambda: chunk if first or gate.wait(10) else None

    actions = []
    for stream.step in range(16):  # six steps beyond the first chunk
        actions.append(executor.advance(prepare, 1)[0])
    assert stream.calls == [(0, [0]), (3, [0])]
    assert torch.equal(torch.stack(actions[:10]), stream.chunks[0, 0])
    assert all(torch.equal(action, actions[9]) for action in actions[10:])
    gate.set()
    executor.reset()


def test_the_next_chunk_is_expected_by_the_longest_of_the_last_delays():
    delays, stream = [], one_robot()
    executor = ChunkExecutor(settings(execution="receding", background=True, latency_steps=2))
    for stream.step in range(8):
        executor.advance(prepared(stream, delays), 1)
        wait(executor)
    assert delays == [0, 2, 1]
    assert list(executor.arrays.delays) == [1, 1]


def test_a_policy_that_is_always_too_slow_ends_the_rollout_with_the_ways_out():
    stream = one_robot()
    executor = ChunkExecutor(settings(execution="receding", background=True))

    def slow_rollout():
        for stream.step in range(60):
            executor.advance(prepared(stream), 1)
            awaited = executor.arrays._awaited
            if awaited is not None and stream.step - awaited.step < 2 * T - 1:
                executor.arrays._take_in = lambda: None
            else:
                wait(executor)
                executor.arrays.__dict__.pop("_take_in", None)

    with pytest.raises(
        ConfigurationError, match=f"{PATIENCE} chunks in a row.*n_action_steps=10.*background=false"
    ):
        slow_rollout()


def test_an_error_in_the_thread_ends_the_rollout():
    stream = one_robot()
    executor = ChunkExecutor(settings(execution="receding", background=True))

    def prepare(envs, delay):
        chunk = stream(envs)
        if stream.step:
            chunk = chunk[:, :3]
        return lambda: chunk

    for stream.step in range(4):
        executor.advance(prepare, 1)
        wait(executor)
    with pytest.raises(ValueError, match="a chunk of 3 actions is too short"):
        executor.advance(prepare, 1)


@pytest.mark.parametrize("forget", ["reset", "clear"])
def test_what_is_being_computed_is_waited_for_and_dropped(forget):
    stream, finished, gate = one_robot(), [], threading.Event()
    executor = ChunkExecutor(settings(execution="receding", background=True))

    def prepare(envs, delay):
        chunk, step = stream(envs), stream.step

        def compute():
            if step:
                gate.wait(10)
            finished.append(step)
            return chunk

        return compute

    for stream.step in range(4):
        executor.advance(prepare, 1)
    threading.Timer(0.05, gate.set).start()
    getattr(executor, forget)()
    assert finished == [0, 3]
    stream.step = 20
    held = executor.advance(prepare, 1)[0]
    wait(executor)
    newest = stream.chunks[20, 0]
    if forget == "reset":  # a new rollout waits for its first chunk
        assert torch.equal(held, newest[0])
    else:
        assert torch.equal(held, stream.chunks[0, 0, 3])
        stream.step = 21
        assert torch.equal(executor.advance(prepare, 1)[0], newest[1])


def test_several_environments_are_refused():
    executor = ChunkExecutor(settings(execution="receding", background=True))
    with pytest.raises(ConfigurationError, match="one robot, not for 2 environments: set background=false"):
        executor.advance(prepared(one_robot()), 2)


def test_the_thread_computes_in_the_modes_of_its_caller():
    seen, stream = [], one_robot()
    executor = ChunkExecutor(settings(execution="receding", background=True))

    def prepare(envs, delay):
        chunk = stream(envs)

        def compute():
            seen.append(
                (torch.is_grad_enabled(), torch.is_inference_mode_enabled(), torch.is_autocast_enabled("cpu"))
            )
            return chunk

        return compute

    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        for stream.step in range(5):
            executor.advance(prepare, 1)
            wait(executor)
    assert seen == [(False, False, True)] * 2


def test_open_loop_leaves_nothing_to_execute_meanwhile():
    with pytest.raises(ConfigurationError, match="background=true: set execution=receding"):
        ExecutionSettings(T, background=True)
