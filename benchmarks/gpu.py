"""What a GPU makes of the policies: training and chunks of this package and of LeRobot, at equal sizes.

    python benchmarks/gpu.py [--batch-size 64] [--out FILE]
    python benchmarks/gpu.py --device cpu --tiny --out rehearsal.json    # small networks, to try the command

Each pair has the sizes of LeRobot's defaults (this package's `preset=paper`), without pretrained weights, and
learns from one batch of random numbers that stays on the device: no data loading, no decoding. It is measured
in float32 and under bfloat16 autocast, as it is and with torch.compile: samples per second of training steps
(forward, backward, AdamW), the time from one observation to the first action of a new chunk, on the CPU, and
the most memory that either took.
"""

import argparse
import json
import platform
import statistics
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.policies.factory import get_policy_class
from rich.console import Console
from torch import Tensor

from lerobot_act_chunking import plugin  # noqa: F401  (registers the policies)

RESULTS = Path(__file__).parent / "results" / "gpu.json"
PAIRS = (("act", "act_chunked"), ("diffusion", "diffusion_chunked"), ("vqbet", "vqbet_chunked"))
TOKENIZER_STEPS = 2
"""Before VQ-BeT's network learns, its tokenizer does; only the network is measured."""
SETTINGS: dict[str, dict[str, Any]] = {
    "act": {},
    "diffusion": {},
    "vqbet": {"n_vqvae_training_steps": TOKENIZER_STEPS},
    "act_chunked": {"preset": "paper"},
    "diffusion_chunked": {"preset": "paper"},
    "vqbet_chunked": {"preset": "paper", "n_vqvae_training_steps": TOKENIZER_STEPS},
}
TINY: dict[str, dict[str, Any]] = {
    "act": {"dim_model": 32, "dim_feedforward": 32, "n_encoder_layers": 1, "n_vae_encoder_layers": 1},
    "diffusion": {"down_dims": (16, 32), "diffusion_step_embed_dim": 16, "num_inference_steps": 2},
    "vqbet": {"gpt_hidden_dim": 32, "gpt_n_layer": 1, "gpt_n_head": 2, "vqvae_enc_hidden_dim": 16},
}
COMPILED = {  # the parts that are called as modules
    "act": ("model",),
    "diffusion": ("diffusion.unet",),
    "vqbet": ("vqbet.policy",),
    "act_chunked": ("model.observation_encoder", "model.style_encoder", "model.encoder", "model.decoder"),
    "diffusion_chunked": ("model.condition", "model.denoiser"),
    "vqbet_chunked": ("model.history", "model.gpt"),
}


def make_policy(kind: str, device: torch.device, *, tiny: bool) -> Any:
    """A policy of this type for one camera and joints, with the sizes of its paper."""
    lerobots = kind.removesuffix("_chunked")
    size = (3, 96, 96) if tiny or lerobots != "act" else (3, 480, 640)
    n_joints = 14 if lerobots == "act" else 2
    inputs = {
        "observation.state": PolicyFeature(FeatureType.STATE, (n_joints,)),
        "observation.images.top": PolicyFeature(FeatureType.VISUAL, size),
    }
    config = PreTrainedConfig.get_choice_class(kind)(
        input_features=inputs,
        output_features={"action": PolicyFeature(FeatureType.ACTION, (n_joints,))},
        device=device.type,
        push_to_hub=False,
        vision_backbone="resnet18",
        pretrained_backbone_weights=None,
        **SETTINGS[kind] | (TINY[lerobots] if tiny else {}),
    )
    torch.manual_seed(0)
    return get_policy_class(kind)(config).to(device)


def make_batch(policy: Any, batch_size: int, device: torch.device) -> dict[str, Tensor]:
    """Random numbers in the shape that LeRobot's loader gives for this policy."""
    config, generator = policy.config, torch.Generator().manual_seed(0)
    steps = config.observation_delta_indices
    window = () if steps is None else (len(steps),)
    batch = {
        key: torch.rand(batch_size, *window, *feature.shape, generator=generator)
        for key, feature in config.input_features.items()
    }
    n_actions, shape = len(config.action_delta_indices), config.action_feature.shape
    batch["action"] = torch.rand(batch_size, n_actions, *shape, generator=generator) * 2 - 1
    batch["action_is_pad"] = torch.zeros(batch_size, n_actions, dtype=torch.bool)
    return {key: value.to(device) for key, value in batch.items()}


def observation_of(batch: dict[str, Tensor], policy: Any) -> dict[str, Tensor]:
    """The newest observation of the first sample, as an environment gives it."""
    seen = {key: batch[key][:1] for key in policy.config.input_features}
    has_window = policy.config.observation_delta_indices is not None
    return {key: value[:, -1] if has_window else value for key, value in seen.items()}


def wait(device: torch.device) -> None:
    """Until the device has done everything."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


@dataclass(frozen=True)
class Way:
    """How a policy is run."""

    precision: str
    compiled: bool

    def autocast(self, device: torch.device) -> AbstractContextManager[Any]:
        """Where its forward pass computes in bfloat16, if it does."""
        return torch.autocast(device.type, torch.bfloat16, enabled=self.precision == "bf16")


WAYS = [Way(precision, compiled) for compiled in (False, True) for precision in ("fp32", "bf16")]


def measure(policy: Any, way: Way, device: torch.device, args: argparse.Namespace) -> dict[str, Any]:
    """Throughput of training, latency of chunks, and memory."""
    batch = make_batch(policy, args.batch_size, device)
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=1e-4)

    def learn(way: Way = way) -> None:
        with way.autocast(device):
            loss, _ = policy.forward(batch)
        loss.backward()
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)
        if hasattr(policy, "update"):
            policy.update()

    def act() -> None:
        with torch.inference_mode(), way.autocast(device):
            policy.select_action(observation).cpu()

    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats(device)
    policy.train()
    for _ in range(TOKENIZER_STEPS):  # LeRobot's tokenizer does not learn in bfloat16
        learn(WAYS[0])
    times_of(learn, args.warm_up, device)
    learning = times_of(learn, args.steps, device)
    policy.eval()
    observation = observation_of(batch, policy)
    times_of(act, args.warm_up, device, before=policy.reset)
    acting = times_of(act, args.steps, device, before=policy.reset)
    return {
        "samples_per_s": args.batch_size * len(learning) / sum(learning),
        "chunk_ms": 1000 * statistics.median(acting),
        "chunk_ms_95": 1000 * sorted(acting)[int(0.95 * (len(acting) - 1))],
        "peak_mib": torch.cuda.max_memory_allocated(device) / 2**20 if device.type == "cuda" else None,
    }


def times_of(
    do: Callable[[], None], n_times: int, device: torch.device, before: Callable[[], None] = lambda: None
) -> list[float]:
    """Seconds that each of so many repetitions takes, the device's work included."""
    times = []
    for _ in range(n_times):
        before()
        wait(device)
        start = time.perf_counter()
        do()
        wait(device)
        times.append(time.perf_counter() - start)
    return times


def run(kind: str, way: Way, device: torch.device, args: argparse.Namespace) -> dict[str, Any]:
    """A fresh policy of this type, measured in one way."""
    policy = make_policy(kind, device, tiny=args.tiny)
    if way.compiled:
        torch.compiler.reset()
        for name in COMPILED[kind]:
            part = policy.get_submodule(name)
            part.compile(backend=args.backend)
    n_weights = sum(each.numel() for each in policy.parameters() if each.requires_grad)
    return {"policy": kind, **asdict(way), "weights": n_weights, **measure(policy, way, device, args)}


def table(results: Mapping[str, Any]) -> str:
    """All measurements, this package's beside LeRobot's."""
    lines = [
        "| policy | | million weights | samples/s | chunk, ms | 95 % | MiB |",
        "|---|---|---|---|---|---|---|",
    ]
    for each in results["measured"]:
        way = each["precision"] + (", compiled" if each["compiled"] else "")
        memory = "-" if each["peak_mib"] is None else f"{each['peak_mib']:.0f}"
        lines.append(
            f"| {each['policy']} | {way} | {each['weights'] / 1e6:.1f} | {each['samples_per_s']:.0f} | "
            f"{each['chunk_ms']:.1f} | {each['chunk_ms_95']:.1f} | {memory} |"
        )
    return "\n".join(lines)


def main() -> None:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("--device", choices=("cuda", "cpu"), default="cuda", help="cpu: with --tiny alone")
    parser.add_argument("--tiny", action="store_true", help="small networks, few steps: a rehearsal")
    parser.add_argument("--batch-size", type=int, default=64)
    parser.add_argument("--out", type=Path, default=RESULTS)
    args = parser.parse_args()
    if args.device == "cuda" and not torch.cuda.is_available():
        sys.exit("gpu.py measures a GPU, and PyTorch sees none here; --device cpu --tiny rehearses it")
    if args.device == "cpu" and not (args.tiny and args.out != RESULTS):
        sys.exit("--device cpu is a rehearsal: it needs --tiny, and --out with a file of your own")
    args.warm_up, args.steps, args.backend = (1, 2, "eager") if args.tiny else (10, 50, "inductor")
    args.batch_size = 2 if args.tiny else args.batch_size
    device = torch.device(args.device)
    results = {
        "device": torch.cuda.get_device_name(device) if args.device == "cuda" else platform.machine(),
        "rehearsal": args.tiny,
        "batch_size": args.batch_size,
        "steps": args.steps,
        "versions": {
            "python": platform.python_version(),
            "cuda": torch.version.cuda,
            **{name: version(name) for name in ("torch", "lerobot")},
        },
        "measured": [run(kind, way, device, args) for pair in PAIRS for way in WAYS for kind in pair],
    }
    args.out.write_text(json.dumps(results, indent=1) + "\n")
    Console().print(table(results), soft_wrap=True, markup=False)


if __name__ == "__main__":
    main()
