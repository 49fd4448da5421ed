"""Demonstrations that go two or three ways: who samples them all, and who blends them?

    OMP_NUM_THREADS=1 python benchmarks/planted_modes.py

trains `vqbet_chunked`, an L2 regression with the same trunk, `act_chunked` (L1) and `diffusion_chunked`
(flow) on the same paths, each for seconds, draws 2000 chunks at the start, where the ways part, and writes
benchmarks/results/planted_modes.json and docs/images/planted_modes.png.
"""

import argparse
import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.policies.factory import get_policy_class
from lerobot.utils.import_utils import register_third_party_plugins
from planted_paths import CHUNK, Batch, Judged, Planted, judge
from rich.console import Console
from rich.table import Table
from torch import Tensor, nn

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate

PLANTED = tuple(
    Planted(shares) for shares in ((0.5, 0.5), (0.8, 0.2), (1 / 3, 1 / 3, 1 / 3), (0.8, 0.15, 0.05))
)
SAMPLES, BATCH = 2000, 64
SHOWN = 60
COMMON: dict[str, Any] = {
    "device": "cpu",
    "push_to_hub": False,
    "optimizer_lr": 1e-3,
    "lr_schedule": "cosine",
    "lr_warmup_steps": 50,
}
VQBET = {
    "chunk_size": CHUNK,
    "n_vqvae_training_steps": 600,
    "gpt_hidden_dim": 64,
    "gpt_n_layer": 2,
    "gpt_n_head": 4,
    "head_hidden_dims": (256, 256),
    "focal_gamma": 0.0,
    "top_p": 1.0,  # less leaves out modes that are rarer than the rest of it
}


@dataclass(frozen=True)
class Learner:
    """A policy's type with its settings, trained for a number of steps; or a regression with its trunk."""

    policy: str
    steps: int
    settings: dict[str, Any] = field(default_factory=dict)
    regression: bool = False


LEARNERS = {
    "vqbet_chunked": Learner("vqbet_chunked", 2600, VQBET),
    "vqbet, focal loss": Learner("vqbet_chunked", 2600, {**VQBET, "focal_gamma": 2.0}),
    "L2 regression": Learner("vqbet_chunked", 2000, VQBET, regression=True),
    "act_chunked (L1)": Learner("act_chunked", 1000, {"chunk_size": CHUNK, "dim_model": 64, "n_heads": 4}),
    "diffusion_chunked (flow)": Learner(
        "diffusion_chunked",
        2000,
        {"horizon": CHUNK, "dim_model": 64, "n_heads": 4, "num_inference_steps": 10},
    ),
}


@dataclass(frozen=True)
class Result:
    """One learner on one set of demonstrations."""

    learner: str
    planted: Planted
    seed: int
    judged: Judged
    seconds: float
    chunks: np.ndarray

    def to_json(self) -> dict[str, Any]:
        invalid = SuccessRate(self.judged.invalid, self.judged.chunks)
        return {
            "learner": self.learner,
            "planted": list(self.planted.shares),
            "episodes": self.planted.episodes,
            "seed": self.seed,
            "chunks": self.judged.chunks,
            "shares": [count / self.judged.chunks for count in self.judged.counts],
            "covered": self.judged.covered(self.planted),
            "invalid": invalid.rate,
            "invalid_interval": invalid.interval,
            "median_distance": self.judged.distance,
            "seconds": self.seconds,
        }


class Regression(nn.Module):
    """The chunk as a linear function of the features of a policy's trunk, by least squares."""

    def __init__(self, policy: Any):
        super().__init__()
        self.config, self.window_of = policy.config, policy._window_of
        self.trunk = policy.model
        self.head = nn.Linear(policy.model.gpt.dim, 2 * CHUNK)

    def chunk(self, batch: Batch) -> Tensor:
        return self.head(self.trunk.current(self.window_of(batch, alone=True))).unflatten(1, (CHUNK, 2))

    def forward(self, batch: Batch) -> tuple[Tensor, dict[str, float]]:
        squares = (self.chunk(batch) - batch["action"]) ** 2
        return squares[~batch["action_is_pad"]].mean(), {}

    def get_optim_params(self) -> list[Tensor]:
        return list(self.parameters())

    def update(self) -> None:
        pass


def make(learner: Learner) -> Any:
    """A fresh policy of 2-D positions, or a regression with its trunk."""
    register_third_party_plugins()
    inputs = {"observation.state": PolicyFeature(FeatureType.STATE, (2,))}
    outputs = {"action": PolicyFeature(FeatureType.ACTION, (2,))}
    config = PreTrainedConfig.get_choice_class(learner.policy)(
        input_features=inputs, output_features=outputs, **COMMON, **learner.settings
    )
    policy = get_policy_class(learner.policy)(config)
    return Regression(policy) if learner.regression else policy


def train(policy: Any, data: Batch, steps: int, seed: int) -> None:
    """As lerobot-train does, over tensors in memory."""
    optimizer = policy.config.get_optimizer_preset().build(policy.get_optim_params())
    schedule = policy.config.get_scheduler_preset().build(optimizer, steps)
    generator = torch.Generator().manual_seed(seed)
    policy.train()
    for _ in range(steps):
        rows = torch.randint(len(data["action"]), (BATCH,), generator=generator)
        loss, _ = policy({key: value[rows] for key, value in data.items()})
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(policy.parameters(), policy.config.get_optimizer_preset().grad_clip_norm)
        optimizer.step()
        schedule.step()
        policy.update()
    policy.eval()


@torch.no_grad()
def sample(policy: Any, n: int) -> np.ndarray:
    """Chunks (n, CHUNK, 2) at the start; one is enough of those that always answer the same."""
    batch = {"observation.state": torch.zeros(1, 2)}
    if isinstance(policy, Regression):
        return policy.chunk(batch).numpy()
    policy.reset()
    if hasattr(policy, "predict_samples"):
        return policy.predict_samples(batch, n)[:, 0].numpy()
    return policy.predict_action_chunk(batch).numpy()


def run(name: str, planted: Planted, seed: int) -> Result:
    learner = LEARNERS[name]
    start = time.process_time()
    torch.manual_seed(seed)
    policy = make(learner)
    train(policy, planted.demonstrate(seed), learner.steps, seed)
    chunks = sample(policy, SAMPLES)
    return Result(name, planted, seed, judge(chunks, planted), time.process_time() - start, chunks)


def show(results: list[Result]) -> Table:
    table = Table(box=None, pad_edge=False)
    for column in (
        "demonstrated",
        "learner",
        "seed",
        "shares",
        "covered",
        "invalid (95 %)",
        "distance",
        "CPU s",
    ):
        table.add_column(column)
    for result in results:
        row = result.to_json()
        low, high = row["invalid_interval"]
        table.add_row(
            result.planted.name,
            result.learner,
            str(result.seed),
            "/".join(f"{100 * share:.0f}" for share in row["shares"]),
            f"{row['covered']} of {len(result.planted.shares)}",
            f"{row['invalid']:.1%} ({low:.1%}-{high:.1%})" if row["chunks"] > 1 else f"{row['invalid']:.0%}",
            f"{row['median_distance']:.3f}",
            f"{row['seconds']:.0f}",
        )
    return table


def draw(results: list[Result], out: Path) -> None:
    """Chunks at the start over the experts' paths, a row for each set of demonstrations."""
    from matplotlib.figure import Figure

    names, sets = list(LEARNERS), list(dict.fromkeys(result.planted for result in results))
    figure = Figure(figsize=(3.1 * len(names), 3.1 * len(sets)), layout="constrained")
    axes = figure.subplots(len(sets), len(names), sharex="row", sharey="row", squeeze=False)
    for result in results:
        if result.seed == results[0].seed:
            ax = axes[sets.index(result.planted), names.index(result.learner)]
            _draw_chunks(ax, result)
    for ax, name in zip(axes[0], names, strict=True):
        ax.set_title(f"{name}\n{ax.get_title()}", fontsize=10)
    for ax, planted in zip(axes[:, 0], sets, strict=True):
        ax.set_ylabel(f"demonstrated {planted.name} %")
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=100)


def _draw_chunks(ax: Any, result: Result) -> None:
    for expert in result.planted.experts:
        ax.plot(*expert.T, color="0.75", linewidth=7, solid_capstyle="round", zorder=1)
    for chunk in result.chunks[:SHOWN]:
        one = len(result.chunks) == 1
        ax.plot(*chunk.T, color="tab:red" if one else "tab:blue", linewidth=1.5 if one else 0.5, zorder=2)
    row = result.to_json()
    shares = "/".join(f"{100 * share:.0f}" for share in row["shares"])
    ax.set_title(f"{shares} %, {row['invalid']:.1%} invalid", fontsize=9)
    ax.set_aspect("equal")
    ax.set(xticks=[], yticks=[], xlim=(-1.05, 1.05), ylim=(-1.05, 1.05))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--learners", nargs="+", choices=LEARNERS, default=list(LEARNERS))
    parser.add_argument("--json", type=Path, default=Path("benchmarks/results/planted_modes.json"))
    parser.add_argument("--out", type=Path, default=Path("docs/images/planted_modes.png"))
    arguments = parser.parse_args()
    console = Console(width=120)
    results: list[Result] = []
    for planted in PLANTED:
        for name in arguments.learners:
            for seed in range(arguments.seeds):
                results.append(run(name, planted, seed))
                console.print(show(results[-1:]))
    console.print(show(results))
    draw(results, arguments.out)
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    arguments.json.write_text(json.dumps([result.to_json() for result in results], indent=1) + "\n")


if __name__ == "__main__":
    main()
