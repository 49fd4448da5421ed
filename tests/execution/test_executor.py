import pytest
import torch

from lerobot_act_chunking.execution.executor import ChunkExecutor, NewestChunk

B, T, A = 3, 5, 4


class Predictor:
    """The n-th chunk holds 100 n + step, so that every action tells where it came from."""

    def __init__(self, batch_size=B):
        self.batch_size = batch_size
        self.calls = 0

    def __call__(self):
        self.calls += 1
        steps = torch.arange(T, dtype=torch.float32) + 100 * self.calls
        return steps[None, :, None].expand(self.batch_size, T, A)


def rollout(executor, predictor, n):
    return [executor.step(predictor, predictor.batch_size)[0, 0].item() for _ in range(n)]


@pytest.mark.parametrize(
    ("n_action_steps", "expected"),
    [
        (5, [100, 101, 102, 103, 104, 200, 201]),
        (2, [100, 101, 200, 201, 300, 301, 400]),
        (1, [100, 200, 300, 400, 500, 600, 700]),
    ],
)
def test_executes_the_start_of_each_chunk(n_action_steps, expected):
    assert rollout(ChunkExecutor(n_action_steps, NewestChunk()), Predictor(), 7) == expected


def test_returns_one_action_per_environment():
    assert ChunkExecutor(5, NewestChunk()).step(Predictor(), B).shape == (B, A)


def test_reset_equals_fresh():
    executor = ChunkExecutor(3, NewestChunk())
    rollout(executor, Predictor(), 2)
    assert len(executor) == 1
    executor.reset()
    assert len(executor) == 0
    assert rollout(executor, Predictor(), 7) == rollout(ChunkExecutor(3, NewestChunk()), Predictor(), 7)


def test_another_batch_size_is_another_rollout():
    executor = ChunkExecutor(5, NewestChunk())
    rollout(executor, Predictor(), 2)
    assert executor.step(Predictor(batch_size=2), 2).shape == (2, A)


def test_memory_stays_bounded():
    executor, predictor = ChunkExecutor(2, NewestChunk()), Predictor()
    rollout(executor, predictor, 10_000)
    assert len(executor._buffer._actions) < T
