"""Two processes learn from the halves of a batch what one learns from all of it."""

import json
import multiprocessing
import subprocess
import sys
from copy import deepcopy
from pathlib import Path

import pytest
import torch
from accelerate import FullyShardedDataParallelPlugin
from lerobot.policies.factory import get_policy_class
from policy_cases import CASES, STATE, Case, history_batch
from tiers import full_tier, some
from torch import distributed
from torch.distributed.fsdp import fully_shard

N_SAMPLES, N_PROCESSES = 8, 2
N_BATCHES = 3  # a tokenizer's codes are placed in the first and moved in those behind it
PADDED = torch.tensor([0, 0, 0, 1, 3, 2, 3, 1])  # more in the second half
PAST = {"n_obs_steps": 3, "use_velocity": True}
LATENT = {"use_vae": True, "latent_warmup_steps": 1}
LESSONS = [
    Case("free bits", "act_chunked", STATE, LATENT | {"free_bits": 0.3}),
    Case("mixture", "act_chunked", STATE, LATENT | {"latent_type": "mixture"}),
    Case(
        "codes, gmm",
        "act_chunked",
        STATE,
        LATENT | {"latent_type": "categorical", "action_likelihood": "gmm"},
    ),
    Case("past", "act_chunked", STATE, PAST | {"history_dropout": 0.5, "prefix_steps": 2}),
    Case("mostly padded", "vqbet_chunked", STATE, {"n_vqvae_training_steps": 9}),
]
EXACT = [each for each in CASES if each.settings.get("preset") != "paper"]  # which has dropout
CHOSEN = some(5, EXACT, by=lambda each: each.type)
BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "processes.py"


def lesson(case):
    """A policy whose tokenizer has not learned, and a batch for it."""
    torch.manual_seed(0)
    policy = get_policy_class(case.type)(case.config())
    batch = history_batch(policy, N_SAMPLES)
    steps = torch.arange(batch["action"].shape[1])
    return policy.train(), batch | {"action_is_pad": steps >= len(steps) - PADDED[:, None]}


def learned(policy, batch):
    """Loss and gradients of some batches, averaged over the processes as LeRobot's training does."""
    torch.manual_seed(1)
    numbers = []
    for _ in range(N_BATCHES):
        policy.zero_grad(set_to_none=True)
        loss, _ = policy.forward(batch)
        loss.backward()
        numbers.append(loss.detach())
        numbers += [each.grad for each in policy.parameters() if each.grad is not None]
    return numbers


def learn_half(rank, store, policy, batch, whole, answer):
    """Send how far losses and gradients of two processes are from those of one, relative to the largest."""
    distributed.init_process_group("gloo", init_method=f"file://{store}", rank=rank, world_size=N_PROCESSES)
    half = {key: value.chunk(N_PROCESSES)[rank] for key, value in batch.items()}
    apart = []
    for ours, expected in zip(learned(policy, half), whole, strict=True):
        distributed.all_reduce(ours)
        difference = (ours / N_PROCESSES - expected).abs().max()
        apart.append((difference / expected.abs().max().clamp_min(1e-3)).item())
    answer.put(max(apart))


def learn_half_sharded(rank, store, policy, batch, whole, answer):
    """Send how far the loss is from that of one process; each weight is on one of the two alone."""
    distributed.init_process_group("gloo", init_method=f"file://{store}", rank=rank, world_size=N_PROCESSES)
    for layer in [each for each in policy.modules() if type(each).__name__ in policy._no_split_modules]:
        fully_shard(layer)
    fully_shard(policy)
    torch.manual_seed(1)
    loss, _ = policy({key: value.chunk(N_PROCESSES)[rank] for key, value in batch.items()})
    loss.backward()
    policy.update()
    total = loss.detach()
    distributed.all_reduce(total)
    answer.put((abs(total / N_PROCESSES - whole[0]) / whole[0]).item())


@pytest.fixture
def farthest_apart(tmp_path):
    """The larger of the numbers that two processes send which run ``work`` for a case."""

    def run(work, case):
        policy, batch = lesson(case)
        whole = learned(deepcopy(policy), batch)
        fork = multiprocessing.get_context("fork")
        answer = fork.SimpleQueue()
        given = (tmp_path / "store", policy, batch, whole, answer)
        processes = [fork.Process(target=work, args=(rank, *given)) for rank in range(N_PROCESSES)]
        for each in processes:
            each.start()
        for each in processes:
            each.join()
            assert each.exitcode == 0
        return max(answer.get() for _ in processes)

    return run


def name(case):
    return f"{case.type} {case.name}"


@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
@pytest.mark.parametrize("case", [*CHOSEN, *LESSONS], ids=name)
def test_two_processes_learn_what_one_learns_from_both_their_samples(farthest_apart, case):
    assert farthest_apart(learn_half, case) < 1e-4


@full_tier
@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
@pytest.mark.parametrize("case", EXACT, ids=name)
def test_sharded_weights_have_the_loss_of_whole_ones(farthest_apart, case):
    assert farthest_apart(learn_half_sharded, case) < 1e-5


@pytest.mark.parametrize("case", some(3, CASES, by=lambda each: each.type), ids=name)
def test_accelerate_finds_the_layers_that_it_shards(case):
    policy = get_policy_class(case.type)(case.config())
    plugin = FullyShardedDataParallelPlugin(auto_wrap_policy="transformer_based_wrap")
    plugin.set_auto_wrap_policy(policy)
    classes = plugin.auto_wrap_policy.keywords["transformer_layer_cls"]
    assert {each.__name__ for each in classes} == set(policy._no_split_modules)
    assert classes or case.settings.get("denoiser") == "dit"


@full_tier
def test_lerobots_training_on_two_processes_is_that_of_one(tmp_path):
    cases = ["act_chunked: camera, past, prefix", "diffusion_chunked", "vqbet_chunked: tokenizer first"]
    command = [sys.executable, BENCHMARK, "--steps=24", f"--out={tmp_path / 'out.json'}", "--only", *cases]
    subprocess.run(command, check=True, capture_output=True)
    for each in json.loads((tmp_path / "out.json").read_text())["cases"]:
        assert each["frames_seen_twice"] == 0
        assert each["apart"]["two"]["same_frames"]
        assert each["apart"]["two"]["loss"] < 1e-5
