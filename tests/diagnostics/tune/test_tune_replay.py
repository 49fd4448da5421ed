"""Replay: commands at a demonstrator's observations, and how old what they rest on is."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.diagnostics.tune.candidates import Candidate
from lerobot_act_chunking.diagnostics.tune.replay import HeldOut, reaction_s, replay
from lerobot_act_chunking.execution.executor import ChunkExecutor
from lerobot_act_chunking.policies.loading import LoadedPolicy

FPS = 10


def settings(**options):
    return ExecutionSettings(chunk_size=8, **options)


@pytest.mark.parametrize(
    ("options", "age"),
    [
        ({"execution": "receding", "replan_interval": 1}, 0.0),
        ({"execution": "receding", "replan_interval": 4}, 1.5),
        ({"execution": "receding", "replan_interval": 4, "latency_steps": 2}, 3.5),
        ({"execution": "open_loop"}, 3.5),
        ({"execution": "ensemble", "replan_interval": 1, "ensemble_weighting": "uniform"}, 3.5),
    ],
)
def test_the_age_of_what_a_command_rests_on(options, age):
    assert reaction_s(settings(**options), FPS) == pytest.approx(age / FPS)


def test_older_predictions_weigh_more_in_acts_ensemble():
    ages = [
        reaction_s(settings(execution="ensemble", replan_interval=1, ensemble_weighting=each), FPS)
        for each in ("recency", "uniform", "act")
    ]
    assert ages == sorted(ages)


def test_ages_that_depend_on_the_chunks_are_not_known():
    assert reaction_s(settings(execution="adaptive", replan_interval=2), FPS) is None


class Biased:
    """Its chunks hold the observation of their step, off by a bias that is new in each chunk."""

    def __init__(self):
        self.config = SimpleNamespace(execution_settings=None)
        self.executor = None

    def reset(self):
        self.executor, self.n_chunks = ChunkExecutor(self.config.execution_settings), 0

    def select_action(self, batch):
        def predict(envs):
            self.n_chunks += 1
            ahead = batch["t"][:, None, None] + torch.arange(8.0)[None, :, None]
            return ahead + self.n_chunks

        return self.executor.step(predict, len(batch["t"]))


def test_distance_and_jumps_of_a_planted_policy():
    lengths = (12, 6)
    demonstrated = {at: np.arange(length, dtype=float)[:, None] for at, length in enumerate(lengths)}
    batches = [{"t": torch.tensor([float(min(t, n - 1)) for n in lengths])} for t in range(max(lengths))]
    episodes = ActionEpisodes("", FPS, ["x"], demonstrated)
    held_out = HeldOut(episodes, np.array([2.0]), False, lambda: iter(batches))
    policy = LoadedPolicy(Biased(), lambda batch: batch, lambda actions: actions)
    executed = settings(execution="receding", replan_interval=4)
    found = replay(policy, Candidate((("execution_settings", executed),), executed), held_out)
    # Chunk i is off by i; the first covers steps 0 to 3, the second 4 to 7, the third 8 to 11.
    expected = np.array([1] * 4 + [2] * 4 + [3] * 4 + [1] * 4 + [2] * 2) / 2.0
    assert found.distance == pytest.approx(expected.mean())
    assert found.jump == pytest.approx(0.5)
    assert found.reaction_s == pytest.approx(0.15)
