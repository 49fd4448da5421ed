import gc
import re

import pytest
import torch
from execution_cases import A, B, Stream, T, rollout

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.execution.executor import ChunkExecutor

MODES = {
    "open_loop": {},
    "receding": {"replan_interval": 2},
    "ensemble": {"replan_interval": 2, "temporal_ensemble_coeff": 0.1},
    "late ensemble": {"replan_interval": 2, "temporal_ensemble_coeff": 0.1, "latency_steps": 2},
    "crossfade": {"replan_interval": 2, "crossfade_steps": 2},
    "adaptive cosine": {"replan_interval": 1, "adaptive_kernel": "cosine"},
    "adaptive gaussian": {"replan_interval": 1, "adaptive_kernel": "gaussian"},
    "adaptive gate": {"replan_interval": 1, "adaptive_kernel": "gate", "adaptive_scale": 1.0},
    "coherence": {"replan_interval": 2, "n_samples": 2},
}


@pytest.fixture(params=MODES)
def mode(request):
    return request.param


def executor_for(mode, **changes):
    return ChunkExecutor(
        ExecutionSettings(T, mode.split()[-1 if "late" in mode else 0], **MODES[mode] | changes)
    )


def stream_for(mode, **sizes):
    return Stream(samples=(2,) if mode == "coherence" else (), **sizes)


def numbered(n):
    """The n-th chunk says 100 n + step, so that every action tells where it comes from."""
    return (100 * n + torch.arange(T, dtype=torch.float32))[None, :, None].expand(B, T, A)


def numbers(executor, n_steps):
    calls = iter(range(1, n_steps + 1))
    return [executor.step(lambda _: numbered(next(calls)), B).unique().item() for _ in range(n_steps)]


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({}, [100, 101, 102, 103, 104, 200, 201, 202]),
        ({"n_action_steps": 2}, [100, 101, 200, 201, 300, 301, 400, 401]),
        ({"execution": "receding", "replan_interval": 1}, [100, 200, 300, 400, 500, 600, 700, 800]),
        ({"execution": "receding", "replan_interval": 3}, [100, 101, 102, 200, 201, 202, 300, 301]),
        # Replanned at 3 and 6; usable from 5 and 8 on.
        (
            {"execution": "receding", "replan_interval": 3, "latency_steps": 2},
            [100, 101, 102, 103, 104, 202, 203, 204],
        ),
        # A third and two thirds of the way from the old chunk's 103 and 104 to the new one's 200 and 201.
        (
            {"execution": "crossfade", "replan_interval": 3, "crossfade_steps": 2},
            [100, 101, 102, 103 + 97 / 3, 104 + 97 * 2 / 3, 202, 203 + 97 / 3, 204 + 97 * 2 / 3],
        ),
        (
            {"execution": "crossfade", "replan_interval": 2, "crossfade_steps": 1, "latency_steps": 1},
            [100, 101, 102, (103 + 201) / 2, 202, (203 + 301) / 2, 302, (303 + 401) / 2],
        ),
    ],
)
def test_which_prediction_is_executed(settings, expected):
    assert numbers(ChunkExecutor(ExecutionSettings(T, **settings)), 8) == pytest.approx(expected)


def test_half_a_chunk_between_replans_is_two_network_calls_per_chunk():
    for size in (8, 100):
        stream = Stream(4 * size, chunk_size=size)
        rollout(
            ChunkExecutor(ExecutionSettings(size, "ensemble", replan_interval=size // 2)), stream, 4 * size
        )
        assert [step for step, _ in stream.calls] == [i * size // 2 for i in range(8)]


def test_the_network_is_asked_only_for_environments_that_need_it(mode):
    stream, executor = stream_for(mode), executor_for(mode, replan_interval=5 if mode == "open_loop" else 2)
    rollout(executor, stream, 7, resets={3: [1], 4: torch.tensor([False, False, True])})
    if mode == "open_loop":
        assert stream.calls == [(0, [0, 1, 2]), (3, [1]), (4, [2]), (5, [0])]
    else:
        assert stream.calls == [(0, [0, 1, 2]), (2, [0, 1, 2]), (3, [1]), (4, [0, 2]), (5, [1]), (6, [0, 2])]


def test_environments_that_start_alone_leave_the_others_bit_equal(mode):
    resets = {3: [1], 4: [1], 11: [1, 0], 12: [0]}
    alone = rollout(executor_for(mode), stream_for(mode), 30, resets)
    together = rollout(executor_for(mode), stream_for(mode), 30)
    assert torch.equal(alone[:, 2], together[:, 2])
    assert torch.equal(alone[:11, 0], together[:11, 0])
    assert torch.equal(alone[:3], together[:3])
    assert not torch.equal(alone[3:, 1], together[3:, 1])


def test_an_environment_that_starts_alone_is_like_one_that_starts_afresh(mode):
    actions = rollout(executor_for(mode), stream_for(mode), 30, resets={7: [1]})
    later = stream_for(mode)
    later.chunks = later.chunks[7:]
    expected = rollout(executor_for(mode), later, 23)[:, 1]
    torch.testing.assert_close(actions[7:, 1], expected, rtol=0, atol=1e-12)


def test_reset_is_like_fresh(mode):
    executor, stream = executor_for(mode), stream_for(mode)
    stream.chunks[3:11] = torch.nan  # whatever happened before
    rollout(executor, stream, 13, resets={5: [1]})
    executor.reset()
    assert len(executor) == 0
    again = stream_for(mode)
    assert torch.equal(rollout(executor, again, 30), rollout(executor_for(mode), stream_for(mode), 30))


def test_what_happened_before_a_reset_is_forgotten_for_one_environment(mode):
    executor, stream = executor_for(mode), stream_for(mode)
    stream.chunks[1:7, ..., 1, :, :] = torch.nan
    assert rollout(executor, stream, 30, resets={7: [1]})[7:].isfinite().all()


def test_another_batch_size_is_another_rollout(mode):
    executor = executor_for(mode)
    rollout(executor, stream_for(mode), 3)
    smaller = [stream_for(mode, batch_size=2) for _ in range(2)]
    assert torch.equal(rollout(executor, smaller[0], 20), rollout(executor_for(mode), smaller[1], 20))


def test_chunks_are_left_as_they_are(mode):
    stream = stream_for(mode)
    rollout(executor_for(mode, gripper_dims=(1,)), stream, 30)
    assert torch.equal(stream.chunks, stream_for(mode).chunks)


def test_actions_are_the_callers_to_change(mode):
    executor, stream, kept = executor_for(mode), stream_for(mode), []
    for stream.step in range(30):
        action = executor.step(stream, B)
        kept.append(action.clone())
        action.fill_(torch.nan)
    assert torch.equal(torch.stack(kept), rollout(executor_for(mode), stream_for(mode), 30))


def test_the_length_is_the_steps_until_the_network_runs():
    executor, stream = ChunkExecutor(ExecutionSettings(T, "receding", replan_interval=3)), Stream()
    assert len(executor) == 0
    left = []
    for stream.step in range(5):
        executor.step(stream, B)
        left.append(len(executor))
    assert left == [2, 1, 0, 2, 1]
    executor.reset([1])
    assert len(executor) == 0


def test_events_tell_what_came_when_for_whom():
    executor, stream, events = ChunkExecutor(ExecutionSettings(T)), Stream(), []
    executor.on_chunk = events.append
    rollout(executor, stream, 6, resets={2: [2, 0]})
    executor.reset()
    rollout(executor, stream, 1)
    told = [(event.step, None if event.envs is None else event.envs.tolist()) for event in events]
    assert told == [(0, None), (2, [0, 2]), (5, [1]), (0, None)]
    assert torch.equal(events[1].chunk, stream.chunks[2, [0, 2]])


def test_the_event_of_sampled_chunks_is_the_one_chosen():
    executor, stream, events = executor_for("coherence"), stream_for("coherence"), []
    executor.on_chunk = events.append
    rollout(executor, stream, 1)
    assert torch.equal(events[0].chunk, stream.chunks[0, 0])


def test_the_last_action_is_held_where_no_chunk_covers_a_step():
    executor = ChunkExecutor(ExecutionSettings(T))
    executor.add(numbered(1))
    actions = [executor.pop().unique().item() for _ in range(3 * T)]
    assert actions == [100, 101, 102, 103, *[104] * (2 * T + 1)]
    assert len(executor) == 0
    executor.add(numbered(2))
    assert executor.pop().unique().item() == 200


def test_one_environment_is_held_while_the_others_go_on():
    executor = ChunkExecutor(ExecutionSettings(T))
    executor.add(numbered(1))
    for _ in range(T - 1):
        executor.pop()
    executor.add(numbered(2)[:2], torch.tensor([0, 2]))
    actions = torch.stack([executor.pop()[:, 0] for _ in range(3)])
    assert actions.tolist() == [[200, 104, 200], [201, 104, 201], [202, 104, 202]]


def test_a_late_chunk_is_used_at_once_where_there_is_no_other():
    executor = ChunkExecutor(ExecutionSettings(T, "receding"))
    executor.add(numbered(1), delay=3)
    executor.pop(), executor.pop()
    executor.add(numbered(2), delay=4)
    assert [executor.pop().unique().item() for _ in range(5)] == [102, 103, 104, 203, 204]


@pytest.mark.parametrize(
    ("mode", "n_steps"), [("ensemble", 10_000), ("adaptive gate", 300), ("receding", 300)]
)
def test_memory_stays_bounded(mode, n_steps, unchecked):
    executor, chunk = executor_for(mode, replan_interval=1), torch.zeros(1, T, A)

    def run(n_steps):
        for _ in range(n_steps):
            executor.step(lambda _: chunk, 1)
        parts = vars(executor.arrays._timeline).values()
        gc.collect()
        return len(gc.get_objects()), sum(getattr(part, "nbytes", 0) for part in parts)

    run(100)
    (objects_before, bytes_before), (objects_after, bytes_after) = run(100), run(n_steps)
    assert bytes_after == bytes_before
    assert objects_after < objects_before + 100


@pytest.mark.parametrize(
    ("settings", "chunk", "message"),
    [
        ({}, torch.zeros(B, 4, A), "a chunk of 4 actions is too short for n_action_steps=5"),
        ({}, torch.zeros(B - 1, T, A), "2 chunks for 3 environments"),
        ({"gripper_dims": (1, 4)}, torch.zeros(B, T, A), "gripper_dims=[1, 4] go beyond the 4 action"),
    ],
)
def test_chunks_that_do_not_fit_are_refused(settings, chunk, message):
    executor = ChunkExecutor(ExecutionSettings(T, **settings))
    if not settings:
        executor.add(numbered(1))
    with pytest.raises(ValueError, match=re.escape(message)):
        executor.add(chunk)


def test_the_first_chunks_are_for_all():
    with pytest.raises(
        ValueError, match="the first chunks of a rollout must be for all environments: envs=None"
    ):
        ChunkExecutor(ExecutionSettings(T)).add(numbered(1)[:1], torch.tensor([0]))


def test_there_is_no_action_before_the_first_chunk():
    with pytest.raises(IndexError, match="no prediction covers this step: add a chunk first"):
        ChunkExecutor(ExecutionSettings(T)).pop()
