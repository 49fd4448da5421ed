"""Are planted causes of failure named? One confusion matrix over causes and policy types.

    OMP_NUM_THREADS=1 python benchmarks/planted_faults.py --folder outputs/planted

trains small healthy policies on demonstrations of `planted_world.Courier` and of `transfer_cube`, plants one
fault at a time into copies of them, diagnoses each, and writes benchmarks/results/planted_faults.json. What
is there is not done again. Cells whose policy does not fail often enough are listed with how often it fails.
`python benchmarks/fault_table.py` writes the table of docs/instruments/diagnose.md.
"""

import argparse
import json
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import planted_world
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class
from lerobot.utils.import_utils import register_third_party_plugins
from policy_training import Recording
from rich.console import Console
from rich.table import Table
from safetensors.torch import load_file, save_file

from lerobot_act_chunking.cli.quickstart import run
from lerobot_act_chunking.compat import trackers_off
from lerobot_act_chunking.data.quiet import quiet_missing_ffmpeg
from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec
from lerobot_act_chunking.diagnostics.diagnose.diagnosis import diagnose
from lerobot_act_chunking.diagnostics.diagnose.settings import Settings

RESULT = Path(__file__).parent / "results" / "planted_faults.json"
TYPES = ("act_chunked", "diffusion_chunked", "vqbet_chunked")
COURIER, CUBE = "courier", "transfer_cube"
MOST, FEWEST = 25, 20
NONE, HEALTHY = "none of these", "healthy"
UNDER = ("under-training", "under-training or too little data")
COMMON = {"device": "cpu", "push_to_hub": False, "optimizer_lr": 1e-3, "execution": "crossfade"}
SMALL = {
    "act_chunked": {"chunk_size": 32, "dim_model": 64, "n_heads": 4, "n_encoder_layers": 1, "dropout": 0}
    | {"actions_per_query": 4, "dim_feedforward": 128, "lr_warmup_steps": 100},
    "diffusion_chunked": {"horizon": 32, "actions_per_token": 4, "dim_model": 64, "n_heads": 4, "n_layers": 2}
    | {"time_distribution": "beta", "num_inference_steps": 5, "lr_warmup_steps": 100},
    "vqbet_chunked": {"chunk_size": 32, "gpt_hidden_dim": 64, "gpt_n_layer": 2, "gpt_n_head": 4}
    | {"offset_loss_weight": 1000, "n_vqvae_training_steps": 500},
}
ARM = {
    "act_chunked": {"chunk_size": 20, "dim_model": 128, "n_heads": 4, "n_encoder_layers": 2, "dropout": 0}
    | {"actions_per_query": 1, "lr_warmup_steps": 200},
    "diffusion_chunked": {"horizon": 20, "actions_per_token": 1, "dim_model": 128, "lr_warmup_steps": 200}
    | {"time_distribution": "beta", "num_inference_steps": 5},
    "vqbet_chunked": {"chunk_size": 20, "gpt_hidden_dim": 128, "gpt_n_layer": 2, "gpt_n_head": 4}
    | {"offset_loss_weight": 1000, "n_vqvae_training_steps": 500},
}
STYLE = {"use_vae": True, "kl_weight": 0.001, "n_vae_encoder_layers": 1, "z_inference": "sample"}
STEPS = {
    COURIER: {"act_chunked": 1200, "diffusion_chunked": 3000, "vqbet_chunked": 4500},
    CUBE: {"act_chunked": 1200, "diffusion_chunked": 1200, "vqbet_chunked": 2500},
}
DATA: dict[str, dict[str, Any]] = {
    "left": {},
    "half": {"most_start": 0.0, "seed": 5000},
    "two_ways": {"right": 0.5, "seed": 9000},
}


@dataclass(frozen=True)
class Fault:
    """What is wrong with a policy.

    Attributes:
        truth: the names that a right diagnosis gives to it.
        settings: changed in the checkpoint's configuration.
        spoil: changes the checkpoint's files.
        data: demonstrations that the policy learned from.
        share: of the training, in per cent, after which the weights are taken.
        types: policies that can have it.
        episodes: of the policy as it is, so that enough of them fail.
        environment: fields of the environment.
    """

    truth: tuple[str, ...]
    settings: dict[str, Any] = field(default_factory=dict)
    spoil: Callable[[Path], None] | None = None
    data: str = "left"
    share: int = 100
    types: tuple[str, ...] = TYPES
    episodes: int = 100
    environment: dict[str, Any] = field(default_factory=dict)


def processors(folder: Path, change: Callable[[str, torch.Tensor], torch.Tensor]) -> None:
    """Change every statistic in a checkpoint's processors."""
    for file in folder.glob("policy_*normalizer_processor.safetensors"):
        save_file({name: change(name, value) for name, value in load_file(file).items()}, file)


def inert(folder: Path) -> None:
    """Statistics that leave numbers as they are."""
    zero, one = ("mean",), ("std", "max", "q99", "q90")

    def change(name: str, value: torch.Tensor) -> torch.Tensor:
        kind = name.rpartition(".")[2]
        return torch.full_like(value, 0.0 if kind in zero else 1.0 if kind in one else -1.0)

    processors(folder, change)


def moved(folder: Path) -> None:
    """Statistics of observations elsewhere: shifted and wider, as those of another place would be."""

    def change(name: str, value: torch.Tensor) -> torch.Tensor:
        key, _, kind = name.rpartition(".")
        if key == "action":
            return value
        return 2 * value if kind == "std" else value + 0.4

    processors(folder, change)


def fresh(folder: Path) -> None:
    """Weights that nothing was learned with."""
    config = PreTrainedConfig.from_pretrained(folder)
    torch.manual_seed(1)
    get_policy_class(config.type)(config).save_pretrained(folder)


def still(folder: Path) -> None:
    """An action head that says the same whatever it sees."""
    file = folder / "model.safetensors"
    weights = load_file(file)
    heads = [name for name in weights if name.startswith(("model.head.", "ema.network.head."))]
    save_file(weights | {name: torch.zeros_like(weights[name]) for name in heads}, file)


FAULTS = {
    HEALTHY: Fault((HEALTHY, NONE)),  # no cause is named
    NONE: Fault((NONE,), environment={"unfair": 0.4}),
    "inert statistics": Fault(("inert statistics",), spoil=inert),
    "wrong statistics": Fault(("wrong statistics",), spoil=moved),
    "untrained": Fault(("untrained",), spoil=fresh),
    "holds still": Fault(("holds still",), spoil=still, types=("act_chunked",)),
    "chunk too long": Fault(
        ("chunk too long",),
        {"execution": "open_loop", "replan_interval": None, "crossfade_steps": None},
        episodes=200,
    ),
    "chunk too short": Fault(
        ("chunk too short",), {"execution": "receding", "replan_interval": 1, "crossfade_steps": None}
    ),
    "over-smoothing": Fault(
        ("over-smoothing",),
        {"execution": "ensemble", "crossfade_steps": None, "temporal_ensemble_coeff": 0.3},
    ),
    "latency": Fault(("latency",), {"latency_steps": 20}),
    "too few steps": Fault(
        ("too few steps",), {"num_inference_steps": 1}, data="two_ways", types=("diffusion_chunked",)
    ),
    "data range": Fault(("data range",), data="half", environment={"same_side": True}),
    "under-training": Fault(UNDER, share=10, types=TYPES[:2]),
    "under-training, behind the tokenizer": Fault(UNDER, share=20, types=TYPES[2:]),
    "wrong mode": Fault(
        ("wrong mode",), {"bet_softmax_temperature": 20.0, "top_p": 1.0}, types=("vqbet_chunked",)
    ),
    "wrong mode, style": Fault(("wrong mode",), {"z_hold": "chunk"}, data="two_ways", types=("act_chunked",)),
}


@dataclass(frozen=True)
class Workshop:
    """Where policies are trained and spoilt.

    Attributes:
        folder: of everything.
        console: prints what is done.
    """

    folder: Path
    console: Console

    def trained(self, task: str, kind: str, data: str, share: int = 100) -> Path:
        """A checkpoint, trained where it is missing."""
        recording = Recording(self.folder, CUBE)
        dataset = recording.dataset if task == CUBE else self.folder / COURIER / data
        train = self.folder / task / "train" / f"{kind}_{data}"
        steps = STEPS[task][kind]
        if not (train / "checkpoints" / f"{steps:06d}").exists():
            shutil.rmtree(train, ignore_errors=True)
            if task == CUBE:
                recording.record(self.console)
            else:
                planted_world.record(dataset, 100, **DATA[data])
            run(self._training(task, kind, data, dataset, train), self.console)
        return train / "checkpoints" / f"{steps * share // 100:06d}" / "pretrained_model"

    def _training(self, task: str, kind: str, data: str, dataset: Path, train: Path) -> list[str]:
        steps = STEPS[task][kind]
        timing = {"replan_interval": 4, "crossfade_steps": 2, "chunk_stride": 1}
        if task == CUBE:
            timing = {"replan_interval": 25, "crossfade_steps": 10, "chunk_stride": 5}
        size = SMALL[kind] if task == COURIER else ARM[kind]
        style = STYLE if (kind, data) == ("act_chunked", "two_ways") else {}
        return [
            "lerobot-train",
            *(f"--policy.{name}={value}" for name, value in (COMMON | timing | size | style).items()),
            *(
                f"--policy.type={kind}",
                f"--dataset.repo_id=local/{dataset.name}",
                f"--dataset.root={dataset}",
            ),
            *(f"--output_dir={train}", "--seed=0", f"--steps={steps}", f"--save_freq={steps // 10}"),
            *("--log_freq=500", "--batch_size=64", "--num_workers=0", "--env_eval_freq=0"),
            *trackers_off(),
        ]

    def planted(self, task: str, kind: str, name: str) -> Path:
        """A copy of a checkpoint with a fault in it."""
        fault = FAULTS[name]
        place = self.folder / task / "planted" / kind / name.replace(" ", "_").replace(",", "")
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(self.trained(task, kind, fault.data, fault.share), place)
        config = json.loads((place / "config.json").read_text())
        (place / "config.json").write_text(json.dumps(config | fault.settings))
        if fault.spoil is not None:
            fault.spoil(place)
        return place

    def cell(self, task: str, kind: str, name: str) -> dict[str, Any]:
        """What is said of one policy."""
        fault, started = FAULTS[name], time.process_time()
        out = self.folder / task / "diagnosed" / kind / name.replace(" ", "_").replace(",", "")
        shutil.rmtree(out, ignore_errors=True)  # of another version of this tool, perhaps
        arguments = {"task": CUBE} if task == CUBE else {**fault.environment}
        spec = EnvironmentSpec("aloha_sim" if task == CUBE else "planted_courier", arguments)
        report = diagnose(
            Settings(
                str(self.planted(task, kind, name)),
                spec,
                episodes=fault.episodes,
                most=MOST,
                output_dir=out,
            )
        )
        content = report.to_json()
        named = [each["name"] for each in content["causes"]]
        said = named[0] if named else HEALTHY if report.verdict == "pass" else NONE
        return {
            "task": task,
            "policy": kind,
            "fault": name,
            "training_steps": STEPS[task][kind],
            "failures": content["failures"],
            "episodes": content["episodes"],
            "said": said,
            "all": named,
            "right": said in fault.truth,
            "counts": name == HEALTHY or content["failures"] >= FEWEST,
            "reasons": content["reasons"],
            "cpu_seconds": time.process_time() - started,
        }


def cells() -> list[tuple[str, str, str]]:
    """Every fault that a policy can have, and the healthy policies of the second task."""
    planted = [(COURIER, kind, name) for name, fault in FAULTS.items() for kind in fault.types]
    return planted + [(CUBE, kind, HEALTHY) for kind in TYPES]


def show(results: list[dict[str, Any]], console: Console) -> None:
    """The confusion matrix: faults by what was said."""
    table = Table("fault", *TYPES)
    for name in FAULTS:
        row = []
        for kind in TYPES:
            found = [each for each in results if (each["fault"], each["policy"]) == (name, kind)]
            row.append(
                "; ".join(
                    f"{each['said']} ({each['failures']}/{each['episodes']})"
                    + ("" if each["right"] else " WRONG" if each["counts"] else " too few")
                    for each in found
                )
            )
        table.add_row(name, *row)
    console.print(table)
    counted = [each for each in results if each["counts"]]
    right = sum(each["right"] for each in counted)
    console.print(f"{right} of {len(counted)} cells right, {len(cells()) - len(results)} missing")


def main() -> None:
    parser = argparse.ArgumentParser(description="Plant faults, and see whether they are named.")
    parser.add_argument("--folder", type=Path, default=Path("outputs/planted"))
    parser.add_argument("--output", type=Path, default=RESULT)
    parser.add_argument("--only", nargs="*", default=[""], help="parts of the names of cells to run")
    parser.add_argument("--again", action="store_true", help="run cells that are in the output again")
    options = parser.parse_args()
    quiet_missing_ffmpeg()
    register_third_party_plugins()
    torch.set_num_threads(1)
    console, folder = Console(), options.folder.resolve()
    results = json.loads(options.output.read_text())["cells"] if options.output.exists() else []
    results = [each for each in results if (each["task"], each["policy"], each["fault"]) in cells()]
    workshop = Workshop(folder, console)
    for task, kind, name in cells():
        asked = any(each in f"{task} {kind} {name}" for each in options.only)
        same = [
            each for each in results if (each["task"], each["policy"], each["fault"]) == (task, kind, name)
        ]
        there = [each for each in same if each["training_steps"] == STEPS[task][kind]]
        if not asked or (there and not options.again):
            continue
        results = [each for each in results if each not in same]
        results.append(workshop.cell(task, kind, name))
        console.print(" ".join(map(str, (task, kind, name, "->", results[-1]["said"]))))
        done = {
            "cells": results,
            "missing": [
                f"{task} {kind} {name}"
                for task, kind, name in cells()
                if (task, kind, name)
                not in {(each["task"], each["policy"], each["fault"]) for each in results}
            ],
        }
        options.output.write_text(json.dumps(done, indent=1) + "\n")
    show(results, console)


if __name__ == "__main__":
    main()
