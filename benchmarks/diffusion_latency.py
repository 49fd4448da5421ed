"""Time per chunk and per training step of `diffusion_chunked` beside LeRobot's ``diffusion``.

Both policies get the same observations and take turns, so that whatever else the machine does hits both
alike. Printed are medians and the median of the paired ratios (below 1: ours is faster). ``same`` cases have
one U-Net, one schedule and DDIM steps on both sides; the others put our networks beside LeRobot's defaults
at as many network calls.

    python benchmarks/diffusion_latency.py [--repeats 5] [--threads 2] [--device cpu] [--output file.json]
"""

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy
from lerobot.policies.pretrained import PreTrainedPolicy
from paired_timing import compare

from lerobot_act_chunking.nn.denoisers.unet1d import SIZES
from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)
from lerobot_act_chunking.policies.diffusion_chunked.modeling_diffusion_chunked import DiffusionChunkedPolicy

INPUTS = {
    "observation.state": PolicyFeature(FeatureType.STATE, (14,)),
    "observation.environment_state": PolicyFeature(FeatureType.ENV, (7,)),
}
ACTION = {"action": PolicyFeature(FeatureType.ACTION, (14,))}
STEPS = {"num_inference_steps": 10}
PAPER = {"preset": "paper", "sampler": "ddim", **STEPS}
MANY = 50  # environments
TRAINING_BATCH = 64


@dataclass(frozen=True)
class Case:
    """Settings of both policies, and what to measure of them."""

    name: str
    theirs: dict[str, Any] = field(default_factory=dict)
    ours: dict[str, Any] = field(default_factory=dict)
    quantities: tuple[str, ...] = ("chunk",)


@dataclass(frozen=True)
class Result:
    """Medians in milliseconds, and the median of paired ratios ours / theirs."""

    case: str
    quantity: str
    batch_size: int
    lerobot_parameters: int
    our_parameters: int
    lerobot_ms: float
    ours_ms: float
    ratio: float


def same(size: str, *quantities: str) -> Case:
    """One U-Net on both sides."""
    return Case(f"same U-Net {size}", {"down_dims": SIZES[size]}, {**PAPER, "unet_size": size}, quantities)


CASES = (
    Case("default", ours=STEPS),
    Case("default, U-Net M", {"down_dims": SIZES["M"]}, STEPS, ("chunk", "chunks")),
    Case("mixer d128", ours={**STEPS, "dim_model": 128}),
    Case("mixer d256", ours={**STEPS, "dim_model": 256}),
    Case("dit d128", ours={**STEPS, "denoiser": "dit", "dim_model": 128}),
    Case("dit d256", ours={**STEPS, "denoiser": "dit", "dim_model": 256}),
    same("S", "chunk", "chunks", "training step"),
    same("M", "chunk", "chunks", "training step"),
    same("L", "chunk"),
    same("XL", "chunk"),
)


def make_policies(case: Case, device: str) -> tuple[DiffusionPolicy, DiffusionChunkedPolicy]:
    """LeRobot's policy and ours, with DDIM on LeRobot's side."""
    features = {"input_features": INPUTS, "output_features": ACTION, "device": device, "push_to_hub": False}
    theirs = DiffusionConfig(**features, noise_scheduler_type="DDIM", **STEPS, **case.theirs)
    ours = DiffusionChunkedConfig(**features, **case.ours)
    return DiffusionPolicy(theirs).to(device), DiffusionChunkedPolicy(ours).to(device)


def make_batch(config: Any, batch_size: int) -> dict[str, torch.Tensor]:
    """Random normalised observations and actions, with time axes."""
    generator = torch.Generator().manual_seed(0)
    batch = {
        key: torch.rand(batch_size, config.n_obs_steps, *feature.shape, generator=generator)
        for key, feature in INPUTS.items()
    }
    batch["action"] = torch.randn(batch_size, config.horizon, 14, generator=generator)
    batch["action_is_pad"] = torch.zeros(batch_size, config.horizon, dtype=torch.bool)
    return {key: value.to(config.device) for key, value in batch.items()}


def chunk(policy: PreTrainedPolicy, batch: dict[str, torch.Tensor]) -> Callable[[], None]:
    """A chunk for each environment of the batch."""
    policy.eval()
    observation = {key: batch[key] for key in INPUTS}

    def step() -> None:
        policy.predict_action_chunk(observation)

    return step


def training_step(policy: PreTrainedPolicy, batch: dict[str, torch.Tensor]) -> Callable[[], None]:
    """One step as lerobot-train takes it: forward, backward, clipping, AdamW."""
    optimizer: Any = policy.config.get_optimizer_preset().build(policy.get_optim_params())

    def step() -> None:
        policy.train()
        loss, _ = policy.forward(batch)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), 10.0)
        optimizer.step()
        optimizer.zero_grad()

    return step


QUANTITIES = {
    "chunk": (chunk, 1),
    "chunks": (chunk, MANY),
    "training step": (training_step, TRAINING_BATCH),
}


def run(case: Case, device: str, repeats: int) -> list[Result]:
    """All quantities of one case."""
    torch.manual_seed(0)
    policies = make_policies(case, device)
    parameters = [sum(p.numel() for p in policy.parameters() if p.requires_grad) for policy in policies]
    results = []
    for quantity in case.quantities:
        make, batch_size = QUANTITIES[quantity]
        calls = [make(policy, make_batch(policy.config, batch_size)) for policy in policies]
        results.append(Result(case.name, quantity, batch_size, *parameters, *compare(*calls, repeats)))
    return results


def line(result: Result) -> str:
    """A row of the table."""
    return (
        f"{result.case:18}{result.quantity:15}{result.batch_size:>6}"
        f"{result.lerobot_parameters / 1e6:>9.1f}{result.our_parameters / 1e6:>9.1f}"
        f"{result.lerobot_ms:>12.2f}{result.ours_ms:>12.2f}{result.ratio:>9.4f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare diffusion_chunked with LeRobot's diffusion.")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--only", default="", help="run the cases whose name contains this")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    print("case              quantity        batch  M theirs   M ours  LeRobot ms     ours ms    ratio")
    results = []
    for case in CASES:
        if options.only in case.name:
            for result in run(case, options.device, options.repeats):
                results.append(result)
                print(line(result), flush=True)
    if options.output:
        settings = {"device": options.device, "threads": options.threads, "repeats": options.repeats}
        rows = [asdict(result) for result in results]
        options.output.write_text(json.dumps({**settings, "results": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
