"""Policies as they come on a world and a demonstrator that are not ours: nothing was chosen on them.

    pip install lerobot_env_so101==0.4.0
    OMP_NUM_THREADS=1 MUJOCO_GL=egl python benchmarks/stranger.py

60 demonstrations of the plug-in's own controller (benchmarks/stranger_world.py), 1500 steps of 64 of every
policy type as it comes and of LeRobot's `act`, 200 unseen episodes by `act-chunking eval`. What is there is
not done again. Writes benchmarks/results/stranger.json, which docs/studies/demonstrators.md shows.
"""

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import stranger_world
from policy_training import Training, Variant
from rich.console import Console

from lerobot_act_chunking.cli.main import main as act_chunking

CPU = {"device": "cpu", "push_to_hub": False}
LEROBOT = {"dim_model": 128, "n_heads": 4, "dim_feedforward": 512, "use_vae": False, "dropout": 0}
TYPES = ("act_chunked", "diffusion_chunked", "vqbet_chunked")
VARIANTS = {
    **{kind: Variant({"type": kind, **CPU}, 1500, 64) for kind in TYPES},
    **{f"{kind}_6000": Variant({"type": kind, **CPU}, 6000, 64) for kind in TYPES},
    "act_one_action": Variant({"type": "act_chunked", "actions_per_query": 1, **CPU}, 1500, 64),
    "diffusion_one_action": Variant({"type": "diffusion_chunked", "actions_per_token": 1, **CPU}, 1500, 64),
    **{
        f"lerobot_act_{rate}": Variant(
            {"type": "act", **LEROBOT, **CPU, "chunk_size": 25, "n_action_steps": 6, "optimizer_lr": rate},
            2400,
            64,
            fast_reader=True,
        )
        for rate in ("1e-4", "1e-3")
    },
}


@dataclass(frozen=True)
class Demonstrations:
    """Where they lie, as `Training` asks."""

    dataset: Path
    repo_id: str


def measure(name: str, seed: int, folder: Path, episodes: int, console: Console) -> dict[str, Any]:
    """Train one policy, and let it act."""
    data = Demonstrations(folder / "demonstrations", "local/demonstrations")
    training = Training(folder / name / f"seed_{seed}", VARIANTS[name], seed, data)  # pyright: ignore[reportArgumentType]
    training.train(console)
    out = folder / "eval" / f"{name}_{seed}.json"
    act_chunking(
        [
            *("eval", str(training.checkpoints / "last" / "pretrained_model"), "--env.type=stranger"),
            *("--env.discover_packages_path=stranger_world", "--episodes", str(episodes), "--json", str(out)),
            *("--output-dir", str(folder / "eval" / f"{name}_{seed}"), "--workers", "1"),
        ]
    )
    (policy,) = json.loads(out.read_text())["policies"]
    return {"policy": name, "seed": seed, "train": training.facts, "eval": policy}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--policies", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--folder", type=Path, default=Path("outputs/benchmarks/stranger"))
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/stranger.json"))
    args = parser.parse_args()
    stranger_world.record(args.folder / "demonstrations", 60)
    found = json.loads(args.out.read_text()) if args.out.exists() else []
    for name in args.policies:
        for seed in args.seeds:
            new = measure(name, seed, args.folder, args.episodes, Console(width=160))
            found = [each for each in found if (each["policy"], each["seed"]) != (name, seed)]
            found.append(new)
            args.out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
