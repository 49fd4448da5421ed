"""What only two features together bring out, and random streams that must not be one another's."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from lerobot_act_chunking.data.masking import hold_padding
from lerobot_act_chunking.envs.robotics.env import RoboticsEnv
from lerobot_act_chunking.nn.processes import draw_rows
from lerobot_act_chunking.policies.batch_seeds import BatchSeeds
from lerobot_act_chunking.recording.simulated import noise_stream
from lerobot_act_chunking.sampling.solvers import LinearSampler, Step

NUMBERS = 4000


@pytest.mark.parametrize(
    ("is_pad", "held"),
    [
        ([1, 1, 0, 0, 0], [2, 2, 2, 3, 4]),
        ([0, 0, 0, 1, 1], [0, 1, 2, 2, 2]),
        ([1, 0, 0, 1, 1], [1, 1, 2, 2, 2]),
    ],
)
def test_padding_before_and_behind_an_episode_repeats_its_nearest_step(is_pad, held):
    actions = torch.arange(5.0)[None, :, None].expand(2, 5, 3)
    found = hold_padding(actions, torch.tensor([is_pad, [0] * 5]).bool())
    assert found[0, :, 0].tolist() == held
    assert torch.equal(found[1], actions[1])


def test_a_success_does_not_outlive_its_episode():
    env = RoboticsEnv(task="FetchReach-v4", success="any", obs_type="state")
    succeeds = iter([True, False, False])
    env.layout = SimpleNamespace(
        **{name: getattr(env.layout, name) for name in dir(env.layout) if not name.startswith("__")}
    )
    env.layout.succeeds = lambda _: next(succeeds)
    try:
        env.reset(seed=0)
        terminated = [env.step(np.zeros(4, np.float32))[2]]
        env.reset(seed=1)
        terminated += [env.step(np.zeros(4, np.float32))[2] for _ in range(2)]
    finally:
        env.close()
    assert terminated == [True, False, False]


def correlation(one, other):
    return abs(np.corrcoef(np.ravel(one), np.ravel(other))[0, 1])


def test_the_expert_does_not_draw_the_environments_numbers():
    for seed in (0, 1, 1000):
        expert, environment = noise_stream(seed), np.random.default_rng(seed)
        assert correlation(expert.normal(size=NUMBERS), environment.normal(size=NUMBERS)) < 0.1


def test_multistep_solvers_carry_the_clipped_estimate_over():
    """DPM-Solver++ with a network whose every estimate is outside of the range."""
    steps = (Step(of_x=0.5, of_clean=0.5), Step(of_x=0.5, of_clean=1.0, of_previous=-0.25))
    sampler = LinearSampler(times=torch.tensor([0.9, 0.4]), clip=1.0, steps=steps)
    found = sampler(lambda x, _: torch.full_like(x, 9.0), torch.zeros(1, 2, 3))
    assert torch.allclose(found, torch.full_like(found, 0.5 * 0.5 + 1.0 - 0.25))


def test_ranks_of_a_distributed_run_draw_what_one_process_would(monkeypatch):
    def drawn(n_rows):
        source = BatchSeeds()
        source.seed.fill_(7)  # from the checkpoint or the first rank
        return [draw_rows(torch.rand, (n_rows, 2), generator=source.next_generator("cpu")) for _ in range(3)]

    alone = drawn(12)
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.distributed, "get_world_size", lambda: 3)
    rows = []
    for rank in (0, 1, 2):
        monkeypatch.setattr(torch.distributed, "get_rank", lambda rank=rank: rank)
        rows.append(drawn(4))
    together = torch.cat([torch.cat(parts) for parts in zip(*rows, strict=True)])
    assert torch.equal(together, torch.cat(alone))
    assert len(together.unique()) == together.numel()
