"""Episodes by number of steps: which sampler acts, in which environment, on which seeds."""

from types import SimpleNamespace

import pytest

from lerobot_act_chunking.diagnostics.steps import success
from lerobot_act_chunking.diagnostics.steps.grid import Cell
from lerobot_act_chunking.diagnostics.steps.success import success_by_steps


@pytest.fixture
def acted(monkeypatch):
    """What every group of episodes was run with; episodes succeed on seeds up to 1000 + steps."""
    config = SimpleNamespace(sampler="heun", num_inference_steps=9, timestep_spacing=None)
    acted = []

    def roll_out(policy, env_config, seeds, *, log_chunks, progress):
        of = policy.policy.config
        acted.append((of.sampler, of.num_inference_steps, of.timestep_spacing, env_config, list(seeds)))
        progress(len(seeds))
        return [
            SimpleNamespace(success=seed <= 1000 + of.num_inference_steps, instead=None) for seed in seeds
        ]

    policy = SimpleNamespace(policy=SimpleNamespace(config=config))
    monkeypatch.setattr(success, "load_policy", lambda checkpoint: policy)
    monkeypatch.setattr(success, "roll_out", roll_out)
    return acted


def test_every_cell_runs_the_same_episodes(acted):
    cells, finished = [Cell("ddim", 2, "trailing"), Cell("euler", 3)], []
    seeds = range(1000, 1010)
    found = success_by_steps(
        "policy", cells, "insertion", seeds=seeds, progress=lambda *at: finished.append(at)
    )
    assert [(each.rate.successes, each.rate.episodes) for each in found] == [(3, 10), (4, 10)]
    assert [each.cell for each in found] == cells
    assert acted == [
        ("ddim", 2, "trailing", "insertion", list(seeds)),
        ("euler", 3, None, "insertion", list(seeds)),
    ]
    assert finished == [(10, 20), (20, 20)]
