"""Policies on a device that has shapes and no numbers: ``meta`` stands for a GPU.

What is made on another device ends with an error as on a GPU. So does what is read back, for which a GPU
makes the CPU wait.
"""

import importlib
from contextlib import nullcontext

import numpy as np
import pytest
import torch
from policy_cases import CASES, history_batch, of_every_type
from tiers import some

from lerobot_act_chunking.execution import executor
from lerobot_act_chunking.policies.batch_seeds import BatchSeeds

WAITING = ("edited", "guided", "joint")  # they read plans, or how many chunks teach a tokenizer
EVERY = [case for case in (*CASES, *of_every_type("KEPT")) if case.name not in WAITING]
N_STEPS = 4
COUNTS = ("seed", "n_batches", "n_updates", "n_learned", "n_seen", "n_steps", "step", "initted")


def name(case):
    return f"{case.type} {case.name}"


def no_generator(seeds, device):
    seeds.next_seed()


@pytest.fixture
def read(monkeypatch):
    """The chunks that the CPU takes over, to execute them; without numbers here."""
    taken = []

    def array_of(chunk):
        assert chunk.is_meta
        taken.append(chunk)
        return np.zeros(chunk.shape, np.float32)

    monkeypatch.setattr(executor, "array_of", array_of)
    return taken


@pytest.fixture(autouse=True)
def what_meta_lacks(monkeypatch):
    """A generator, autocast, and numbers to log: the one reading that training needs."""
    monkeypatch.setattr(BatchSeeds, "next_generator", no_generator)
    monkeypatch.setattr(torch, "autocast", lambda *_, **__: nullcontext())
    for kind in sorted({case.type for case in EVERY}):
        modeling = importlib.import_module(f"lerobot_act_chunking.policies.{kind}.modeling_{kind}")
        monkeypatch.setattr(modeling, "finite_terms", lambda loss, terms, *_, **__: dict.fromkeys(terms, 0.0))


@pytest.mark.parametrize(
    "case", some(10, EVERY, by=lambda case: case.type), ids=lambda case: f"{case.type} {case.name}"
)
def test_training_and_acting_stay_on_the_device_and_read_only_new_chunks_back(case, read):
    policy = case.policy()
    batch = {key: value.to("meta") for key, value in history_batch(policy).items()}
    policy.to("meta").train()
    loss, _ = policy.forward(batch)
    loss.backward()
    policy.update()
    assert all(each.grad.is_meta for each in policy.parameters() if each.grad is not None)
    policy.reset()
    observation = {key: batch[key][:, -1] for key in policy.config.input_features}
    asked = []
    for _ in range(N_STEPS):
        asked.append(policy._action_queue.n_steps == 0 or len(policy._action_queue) == 0)
        assert policy.select_action(observation).is_meta
    assert len(read) == sum(asked)


@pytest.mark.parametrize(
    "case", some(3, CASES, by=lambda case: case.type), ids=lambda case: f"{case.type} {case.name}"
)
def test_counts_stay_where_they_are_read_and_are_not_exchanged(case):
    policy = case.policy().to("meta")
    kept = {name for name, each in policy.named_buffers() if each.device.type == "cpu"}
    assert kept == set(policy._ddp_params_and_buffers_to_ignore)
    assert all(each.rpartition(".")[2] in COUNTS for each in kept)
    assert policy.ema is None or "ema.step" in kept
