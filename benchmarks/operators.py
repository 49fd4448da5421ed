"""How policies learn from people with different habits, and how they should act then.

    OMP_NUM_THREADS=1 python benchmarks/operators.py --operators unhurried hesitant --tasks transfer_cube

Each operator (lerobot_act_chunking/envs/operators.py), and ten of them in turn (`everybody`), demonstrates
each ALOHA task 50 times and each Fetch task 100 times, or as often as is asked for. Policies learn from one
of these datasets as they come and act in the same 200 unseen episodes, by several settings of execution.
Every training and every evaluation is written down when it is done, so that the study can be stopped and
gone on with, and several may run side by side. The results are in benchmarks/results/operators.json, one
entry for each evaluation.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml
from policy_study import Cell, Run, Study, row
from policy_training import Variant, usual_episodes
from rich.console import Console
from rich.table import Table

from lerobot_act_chunking.envs.operators import OPERATORS

EVERYBODY = "everybody"
PEOPLE = tuple(name for name, habits in OPERATORS.items() if not habits.stepwise)
"""Who is everybody: all who do the tasks in the same way."""
CPU = {"device": "cpu", "push_to_hub": False}
HISTORY = {"n_obs_steps": 2, "obs_stride": 25, "history_dropout": 0.3}
STYLE = {"use_vae": True, "latent_dim": 16, "kl_weight": 0.01, "free_bits": 0.05, "z_inference": "sample"}
EVERY_STEP: dict[str, dict[str, Any]] = {
    "act_chunked": {"chunk_size": 100},
    "diffusion_chunked": {"horizon": 100},
    "vqbet_chunked": {"chunk_size": 100},
}
SLOWER = {"optimizer_lr": 5e-4, "lr_warmup_steps": 500}
"""How `diffusion_chunked` was trained by default until 0.1.0."""
LEROBOT = {
    "type": "act",
    "dim_model": 128,
    "n_heads": 4,
    "dim_feedforward": 512,
    "use_vae": False,
    "dropout": 0,
    **CPU,
}
"""LeRobot's `act` at a size that it can train 2400 steps of in ten minutes; it predicts every step."""


def recipe(name: str, *without: str) -> Variant:
    """What a file in configs/ trains, without these settings."""
    path = Path(__file__).parents[1] / "configs" / f"{name}.yaml"
    content = yaml.safe_load(path.read_text())
    policy = {key: value for key, value in content["policy"].items() if key not in without}
    return Variant(policy, content["steps"], content["batch_size"])


VARIANTS = {
    **{
        f"{kind}{name}_{steps}": Variant({"type": kind, **given, **CPU}, steps, 64)
        for kind, every_step in EVERY_STEP.items()
        for name, given in (("", {}), ("_every_step", every_step))
        for steps in (1500, 3000, 4000)
    },
    **{
        f"diffusion_slower{name}_{steps}": Variant(
            {"type": "diffusion_chunked", **given, **SLOWER, **CPU}, steps, 64
        )
        for name, given in (("", {}), ("_every_step", EVERY_STEP["diffusion_chunked"]))
        for steps in (1500, 4000)
    },
    **{
        f"{kind}_faster_1500": Variant({"type": f"{kind}_chunked", "optimizer_lr": rate, **CPU}, 1500, 64)
        for kind, rate in (("act", 1e-3), ("diffusion", 2e-3), ("vqbet", 1e-3))
    },
    "diffusion_slower_128_2000": Variant(
        {"type": "diffusion_chunked", "dim_model": 128, **SLOWER, **CPU}, 2000, 64
    ),
    "act_one_action_1500": Variant({"type": "act_chunked", "actions_per_query": 1, **CPU}, 1500, 64),
    "act_chunked_history_1500": Variant(
        {"type": "act_chunked", "chunk_size": 100, **HISTORY, **CPU}, 1500, 64
    ),
    "act_small_4000": recipe("quickstart"),
    "act_small_spaced_4000": recipe("quickstart", "chunk_size", "actions_per_query"),
    "diffusion_recipe": recipe("diffusion"),
    "vqbet_recipe": recipe("vqbet"),
    "act_vae_1500": Variant({"type": "act_chunked", **STYLE, **CPU}, 1500, 64),
    "act_12x2_1500": Variant(
        {"type": "act_chunked", "chunk_size": 12, "chunk_stride": 2, "actions_per_query": 4, **CPU}, 1500, 64
    ),
    **{
        f"lerobot_act_{rate}": Variant({**LEROBOT, "optimizer_lr": rate}, 2400, 64, fast_reader=True)
        for rate in ("1e-4", "3e-4", "1e-3")
    },
    "vqbet_50_1500": Variant({"type": "vqbet_chunked", "chunk_size": 50, **CPU}, 1500, 64),
}
"""Policies by type and training steps, as they come and with a prediction for every step; those of configs/;
LeRobot's `act` by its learning rate; and others by what is different in them."""
EXECUTIONS: dict[str, dict[str, Any]] = {
    "as it comes": {},
    "crossfade 25 over 50": {"execution": "crossfade", "replan_interval": 25, "crossfade_steps": 50},
    "crossfade 25 over 10": {"execution": "crossfade", "replan_interval": 25, "crossfade_steps": 10},
    **{
        f"crossfade {interval} over 50": {
            "execution": "crossfade",
            "replan_interval": interval,
            "crossfade_steps": 50,
        }
        for interval in (5, 10, 15, 20)
    },
    **{
        f"{name}, mean of 5": {**execution, "smoothing_steps": 5}
        for name, execution in {
            "crossfade 25 over 50": {"execution": "crossfade", "replan_interval": 25, "crossfade_steps": 50},
            "open loop": {"execution": "open_loop", "replan_interval": None},
        }.items()
    },
    "crossfade 6 over 12": {"execution": "crossfade", "replan_interval": 6, "crossfade_steps": 12},
    "ensemble 6": {"execution": "ensemble", "replan_interval": 6},
    **{
        f"receding {interval}": {"execution": "receding", "replan_interval": interval}
        for interval in (2, 4, 6, 10, 12)
    },
    "crossfade 50 over 10": {"execution": "crossfade", "replan_interval": 50, "crossfade_steps": 10},
    "open loop": {"execution": "open_loop", "replan_interval": None},
    "ensemble 25": {"execution": "ensemble", "replan_interval": 25},
    "ensemble 10": {"execution": "ensemble", "replan_interval": 10},
    "adaptive 25": {"execution": "adaptive", "replan_interval": 25},
}
"""Settings of execution, by name."""
UNSET = {"crossfade_steps": None, "temporal_ensemble_coeff": None, "ensemble_weighting": None}


def runs(task: str, variants: list[str], seeds: list[int], executions: list[str]) -> Iterator[Run]:
    """All that is asked for of one task."""
    for variant in variants:
        for seed in seeds:
            for name in executions:
                yield Run(task, variant, seed, sampling=sampling_of(name))


def sampling_of(name: str) -> dict[str, Any]:
    """Settings of an execution, and none of those that belong to another."""
    asked = EXECUTIONS[name]
    return {**UNSET, **asked} if asked else {}


def named(cell: Cell) -> str:
    """The execution of a cell."""
    return next(name for name in EXECUTIONS if sampling_of(name) == cell.run["sampling"])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--operators", nargs="+", choices=[*OPERATORS, EVERYBODY], default=list(OPERATORS))
    parser.add_argument("--tasks", nargs="+", default=["transfer_cube", "insertion"])
    parser.add_argument("--demonstrations", type=int, help="in the place of 50 or 100")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=["act_chunked_1500"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--executions", nargs="+", choices=EXECUTIONS, default=list(EXECUTIONS))
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--folder", type=Path, default=Path("outputs/benchmarks/operators"))
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/operators.json"))
    args = parser.parse_args()
    console = Console(width=160)
    for name in args.operators:
        people = PEOPLE if name == EVERYBODY else (name,)
        place = name if args.demonstrations is None else f"{name}_{args.demonstrations}"
        study = Study(
            args.folder / place,
            args.folder / "recordings" / place,
            VARIANTS,
            console,
            people,
            args.demonstrations,
        )
        for task in args.tasks:
            cells = study.cells(runs(task, args.variants, args.seeds, args.executions), args.episodes)
            show(place, cells, console)
            keep(name, args.demonstrations or usual_episodes(task), cells, args.out)


def show(operator: str, cells: list[Cell], console: Console) -> None:
    """Print the cells of one operator."""
    table = Table("task", "policy", "training", "execution", "success %", "95 % Wilson", title=operator)
    for cell in cells:
        task, policy, training, _, _, success, interval, *_ = row(cell)
        table.add_row(task, policy, training, named(cell), success, interval)
    console.print(table)


def keep(operator: str, demonstrations: int, cells: list[Cell], path: Path) -> None:
    """Add the cells to what is there, in the place of what was measured before."""
    there = json.loads(path.read_text()) if path.exists() else []
    of_all = {"operator": operator, "demonstrations": demonstrations}
    new = [{**of_all, "execution": named(cell), **asdict(cell)} for cell in cells]
    kept = [entry for entry in there if _key(entry) not in [_key(each) for each in new]]
    part = path.with_suffix(".part")
    entries = sorted([*kept, *new], key=lambda entry: json.dumps(_key(entry)))
    part.write_text(json.dumps(entries, indent=1) + "\n")
    part.replace(path)


def _key(entry: dict[str, Any]) -> list[Any]:
    run = entry["run"]
    dataset = [entry["operator"], run["task"], entry["demonstrations"]]
    return [*dataset, run["variant"], run["seed"], entry["execution"]]


if __name__ == "__main__":
    main()
