"""Training step and action latency of `act_chunked` beside LeRobot's ``act``, at identical settings.

Both policies get the same sizes, the same batches and LeRobot's AdamW, and take turns, so that whatever else
the machine does hits both alike. Printed are medians and the median of the paired ratios (below 1: ours is
faster). `act_chunked` computes less (`nn.transformer.Decoder`, `nn.style_encoder`), not something else.

The last case is another comparison: LeRobot's `act` and our preset ``base``, each as it comes.

    python benchmarks/policy.py [--repeats 10] [--threads 2] [--output policy.json]
"""

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.pretrained import PreTrainedPolicy
from paired_timing import compare

from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig
from lerobot_act_chunking.policies.act_chunked.modeling_act_chunked import ActChunkedPolicy

STATE = {"observation.state": PolicyFeature(FeatureType.STATE, (14,))}
ENVIRONMENT = {"observation.environment_state": PolicyFeature(FeatureType.ENV, (7,))}
CAMERA = {"observation.images.top": PolicyFeature(FeatureType.VISUAL, (3, 480, 640))}
ACTION = {"action": PolicyFeature(FeatureType.ACTION, (14,))}
SMALL = {
    "dim_model": 128,
    "n_heads": 4,
    "dim_feedforward": 512,
    "n_encoder_layers": 2,
    "n_vae_encoder_layers": 2,
}


@dataclass(frozen=True)
class Case:
    """One setting that both policies are built with; ours with this preset."""

    name: str
    inputs: dict[str, PolicyFeature]
    batch_size: int
    settings: dict[str, Any]
    preset: str = "paper"


@dataclass(frozen=True)
class Result:
    """Medians in milliseconds, and the median of paired ratios ours / theirs."""

    case: str
    quantity: str
    lerobot_ms: float
    ours_ms: float
    ratio: float


CASES = (
    Case("state d128", STATE | ENVIRONMENT, 64, SMALL | {"use_vae": False}),
    Case("state d128 vae", STATE | ENVIRONMENT, 64, SMALL | {"use_vae": True}),
    Case("state d128 no dropout", STATE | ENVIRONMENT, 64, SMALL | {"use_vae": False, "dropout": 0.0}),
    Case("state d512 vae", STATE | ENVIRONMENT, 32, {}),
    Case("camera d512 vae", STATE | CAMERA, 4, {}),
    Case("base, act's default", STATE | ENVIRONMENT, 32, {}, preset="base"),
)


def make_policies(case: Case) -> tuple[PreTrainedPolicy, PreTrainedPolicy]:
    """LeRobot's policy and ours, alike."""
    shared = {
        "input_features": case.inputs,
        "output_features": ACTION,
        "device": "cpu",
        "push_to_hub": False,
        "pretrained_backbone_weights": None,
        **case.settings,
    }
    return ACTPolicy(ACTConfig(**shared)), ActChunkedPolicy(ActChunkedConfig(preset=case.preset, **shared))


def make_batch(case: Case, batch_size: int) -> dict[str, torch.Tensor]:
    """Random normalised inputs; a tenth of the chunk is padding in half of the samples."""
    generator = torch.Generator().manual_seed(0)
    batch = {k: torch.rand(batch_size, *f.shape, generator=generator) for k, f in case.inputs.items()}
    batch["action"] = torch.randn(batch_size, 100, 14, generator=generator)
    batch["action_is_pad"] = torch.zeros(batch_size, 100, dtype=torch.bool)
    batch["action_is_pad"][::2, 90:] = True
    return batch


def training_step(policy: PreTrainedPolicy, batch: dict[str, torch.Tensor]) -> Callable[[], None]:
    """One step as lerobot-train takes it: forward, backward, clipping, AdamW."""
    optimizer: Any = policy.config.get_optimizer_preset().build(policy.get_optim_params())
    policy.train()

    def step() -> None:
        loss, _ = policy.forward(batch)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), 10.0)
        optimizer.step()
        optimizer.zero_grad()

    return step


def new_chunk(policy: PreTrainedPolicy, batch: dict[str, torch.Tensor]) -> Callable[[], None]:
    """The control step that runs the network."""
    policy.eval()

    def step() -> None:
        policy.reset()
        policy.select_action(batch)

    return step


def whole_chunk(policy: PreTrainedPolicy, batch: dict[str, torch.Tensor]) -> Callable[[], None]:
    """All 100 control steps of a chunk, the network run once."""
    policy.eval()

    def steps() -> None:
        policy.reset()
        for _ in range(100):
            policy.select_action(batch)

    return steps


def run(case: Case, repeats: int) -> list[Result]:
    """All quantities of one case."""
    theirs, ours = make_policies(case)
    batch, observation = make_batch(case, case.batch_size), make_batch(case, 1)
    quantities = (
        ("select_action", new_chunk, observation, 3 * repeats),
        ("100 actions", whole_chunk, observation, repeats),
        ("training step", training_step, batch, repeats),
    )
    return [
        Result(case.name, name, *compare(make(theirs, data), make(ours, data), n))
        for name, make, data, n in quantities
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare act_chunked with LeRobot's act.")
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--only", default="", help="run the cases whose name contains this")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    results = []
    print(f"{'case':24}{'quantity':16}{'LeRobot ms':>12}{'ours ms':>12}{'ratio':>8}")
    for case in CASES:
        if options.only in case.name:
            for result in run(case, options.repeats):
                results.append(result)
                print(
                    f"{result.case:24}{result.quantity:16}"
                    f"{result.lerobot_ms:12.2f}{result.ours_ms:12.2f}{result.ratio:8.2f}",
                    flush=True,
                )
    if options.output:
        options.output.write_text(json.dumps([asdict(result) for result in results], indent=2))


if __name__ == "__main__":
    main()
