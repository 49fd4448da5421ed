import torch

from act_chunking_runtime import coherence
from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.execution.executor import ChunkExecutor

ALL = torch.ones(1, 3, dtype=torch.bool)


def samples(*chunks):
    """One environment, one action dimension."""
    return torch.tensor(chunks, dtype=torch.float32)[:, None, :, None]


def most_coherent(*tensors):
    return torch.from_numpy(coherence.most_coherent(*(each.numpy() for each in tensors)))


def chosen(candidates, plan, covered=ALL):
    plan = torch.tensor(plan, dtype=torch.float32)[None, :, None]
    return most_coherent(candidates, plan, covered)[0, :, 0].tolist()


def test_picks_the_sample_nearest_to_the_plan():
    assert chosen(samples([9, 9, 9], [1, 2, 4], [3, 3, 3]), [1, 2, 3]) == [1, 2, 4]


def test_near_steps_count_most():
    """By a half per step: 1 now is more than 1.5 at the next step, and less than 4.5 at the one after."""
    assert chosen(samples([1, 0, 0], [0, 1.5, 0]), [0, 0, 0]) == [0, 1.5, 0]
    assert chosen(samples([1, 0, 0], [0, 0, 4.5]), [0, 0, 0]) == [1, 0, 0]


def test_steps_without_a_plan_do_not_count():
    covered = torch.tensor([[True, False, False]])
    assert chosen(samples([1, 0, 0], [0, 9, 9]), [0, 0, 0], covered) == [0, 9, 9]
    assert chosen(samples([1, 0, 0], [0, 0, 0]), [0, 0, 0], torch.zeros_like(ALL)) == [1, 0, 0]


def test_longer_samples_are_compared_where_the_plan_is():
    assert chosen(samples([1, 1, 1, 0], [0, 0, 0, 9]), [0, 0, 0]) == [0, 0, 0, 9]


def test_every_environment_picks_its_own():
    candidates = torch.stack([torch.zeros(2, 3, 4), torch.ones(2, 3, 4), torch.full((2, 3, 4), 2.0)])
    plan = torch.stack([torch.full((3, 4), 1.9), torch.full((3, 4), 1.1)])
    assert most_coherent(candidates, plan, ALL)[:, 0, 0].tolist() == [2, 1]
    covered = torch.tensor([[False] * 3, [True] * 3])
    assert most_coherent(candidates, plan, covered)[:, 0, 0].tolist() == [0, 1]


def test_the_executor_continues_what_it_was_doing():
    executor = ChunkExecutor(ExecutionSettings(4, "coherence", replan_interval=2, n_samples=2))
    branches = torch.stack([torch.zeros(1, 4, 1), torch.ones(1, 4, 1)])
    first = torch.stack([torch.ones(1, 4, 1), torch.zeros(1, 4, 1)])
    predictions = iter([first, branches, branches])
    actions = [executor.step(lambda _: next(predictions), 1).item() for _ in range(6)]
    assert actions == [1] * 6
    executor.reset()
    assert executor.step(lambda _: branches, 1).item() == 0
