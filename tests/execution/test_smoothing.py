"""The moving mean within a chunk."""

import pytest
import torch
from execution_cases import A, B, Stream, T, rollout

from act_chunking_runtime import smoothing
from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.execution.executor import ChunkExecutor


def moving_mean(chunk, *arguments, **options):
    return torch.from_numpy(smoothing.moving_mean(chunk.numpy(), *arguments, **options))


def test_each_action_is_the_mean_of_those_around_it():
    chunk = torch.tensor([1.0, 3.0, 6.0, 0.0, 9.0])[:, None]
    assert moving_mean(chunk, 3)[:, 0].tolist() == pytest.approx([5 / 3, 10 / 3, 3, 5, 6])


def test_a_straight_motion_is_neither_delayed_nor_changed_but_at_its_ends():
    chunk = torch.arange(20, dtype=torch.float64)[None, :, None]
    torch.testing.assert_close(moving_mean(chunk, 5)[:, 2:-2], chunk[:, 2:-2])


def test_independent_errors_lose_all_but_a_share_of_their_variance():
    errors = torch.randn(1, 100_000, 1, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    assert moving_mean(errors, 5).var().item() == pytest.approx(1 / 5, rel=0.03)


@pytest.mark.parametrize("shape", [(B, T, A), (4, B, T, A)])
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.float16])
def test_every_chunk_alone_in_its_own_precision(shape, dtype):
    chunks = torch.rand(shape, generator=torch.Generator().manual_seed(0)).to(dtype)
    smooth = moving_mean(chunks, 3)
    assert smooth.shape == chunks.shape
    assert smooth.dtype == dtype
    assert torch.equal(smooth[..., 1, :, :], moving_mean(chunks[..., 1, :, :], 3))


def test_grippers_stay_as_they_are():
    chunk = torch.rand(B, T, A, generator=torch.Generator().manual_seed(0))
    smooth = moving_mean(chunk, 3, gripper_dims=(1, 3))
    assert torch.equal(smooth[..., [1, 3]], chunk[..., [1, 3]])
    assert not torch.equal(smooth[..., [0, 2]], chunk[..., [0, 2]])


def test_what_may_not_be_executed_does_not_matter():
    settings = ExecutionSettings(T, "receding", n_action_steps=3, replan_interval=2, smoothing_steps=3)
    stream, strange = Stream(), Stream()
    strange.chunks[..., 3:, :] = torch.nan
    assert torch.equal(
        rollout(ChunkExecutor(settings), stream, 9), rollout(ChunkExecutor(settings), strange, 9)
    )


@pytest.mark.parametrize("execution", ["open_loop", "receding", "ensemble", "crossfade", "adaptive"])
def test_executing_smoothed_chunks_is_executing_the_means_of_them(execution):
    smoothing = ChunkExecutor(ExecutionSettings(T, execution, smoothing_steps=3, gripper_dims=(2,)))
    plain = ChunkExecutor(ExecutionSettings(T, execution, gripper_dims=(2,)))
    means = Stream()
    means.chunks = moving_mean(means.chunks, 3, gripper_dims=(2,))
    assert torch.equal(rollout(smoothing, Stream(), 20), rollout(plain, means, 20))


def test_instruments_get_the_chunk_as_it_was_predicted():
    executor, stream, seen = ChunkExecutor(ExecutionSettings(T, smoothing_steps=3)), Stream(), []
    executor.on_chunk = lambda event: seen.append(event.chunk)
    rollout(executor, stream, 1)
    assert torch.equal(seen[0], stream.chunks[0])
