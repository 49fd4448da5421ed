"""Success of policies that sample, with the draws of episodes shared, as they once were, and independent.

    OMP_NUM_THREADS=1 python benchmarks/episode_draws.py

Until episodes had random streams of their own, the 200 episodes of an evaluation in batches of 50 replayed 50
draws four times. Every training that benchmarks/diffusion_success.py, vqbet_success.py, act_success.py or
fetch.py has evaluated acts again here, in the same episodes, with draws shared in that way. The table has
three figures for each: the one published before (another training, on another machine), and those of the same
checkpoint with shared and with independent draws. It is written to benchmarks/results/episode_draws.json.
"""

import argparse
import json
from pathlib import Path
from typing import Any
from unittest.mock import patch

from act_variants import VARIANTS as ACT
from diffusion_variants import VARIANTS as DIFFUSION
from fetch_variants import VARIANTS as FETCH
from policy_study import N_ENVS, Cell, Run, evaluate
from policy_training import Recording, Training
from rich.console import Console
from rich.table import Table
from vqbet_variants import VARIANTS as VQBET

VARIANTS = {"act": ACT, "diffusion": DIFFUSION, "vqbet": VQBET, "fetch": FETCH}
BEFORE = Path("benchmarks/results/shared_draws_published.json")


def draws_anything(cell: Cell, study: str) -> bool:
    """Whether its policy draws anything."""
    kind = VARIANTS[study][cell.run["variant"]].policy["type"]
    sampled = kind == "act_chunked" and cell.run["sampling"].get("z_inference") == "sample"
    greedy = cell.run["sampling"].get("bet_softmax_temperature") == 0
    return sampled or kind == "diffusion_chunked" or (kind == "vqbet_chunked" and not greedy)


def with_shared_draws(training: Training, asked: Run, episodes: int) -> Cell:
    """The same evaluation, but the draws of an episode follow from its place in the batch alone."""

    def reset(policy: Any, seeds: list[int]) -> None:
        policy.reset(episode_seeds=range(len(seeds)))

    with patch("lerobot_act_chunking.diagnostics.core.rollouts.reset_episodes", reset):
        return evaluate(training, asked, episodes)


def compare(path: Path, study: str, published: dict[str, str]) -> dict[str, Any] | None:
    """One row; None if the policy draws nothing. What was run with shared draws is kept beside ``path``."""
    cell = Cell(**json.loads(path.read_text()))
    if not draws_anything(cell, study):
        return None
    asked, kept = Run(**cell.run), path.with_suffix(".shared")
    if not kept.exists():
        variant = VARIANTS[study][asked.variant]
        training = Training(path.parent, variant, asked.seed, Recording(path, asked.task))
        kept.write_text(json.dumps(with_shared_draws(training, asked, cell.episodes).failed_seeds))
    shared = json.loads(kept.read_text())
    return {
        "study": study,
        **cell.run,
        "episodes": cell.episodes,
        "published": published.get(key(study, cell.run)),
        "shared": cell.episodes - len(shared),
        "independent": cell.rate.successes,
        "only_shared": len(set(cell.failed_seeds) - set(shared)),
        "only_independent": len(set(shared) - set(cell.failed_seeds)),
    }


def key(study: str, run: dict[str, Any]) -> str:
    """Name of an evaluation in the file of published figures."""
    sampling = " ".join(f"{name}={value}" for name, value in run["sampling"].items())
    return " ".join(
        filter(None, (study, run["task"], run["variant"], str(run["seed"]), run["checkpoint"], sampling))
    )


def show(rows: list[dict[str, Any]], console: Console) -> None:
    table = Table(
        "task",
        "policy",
        "seed",
        "sampling",
        "episodes",
        "published",
        "shared",
        "independent",
        f"batches of {N_ENVS}",
    )
    for row in rows:
        differ = f"{row['only_shared']} only shared, {row['only_independent']} only independent"
        sampling = " ".join(str(value) for value in row["sampling"].values()) or "as trained"
        counts = [str(row[name]) for name in ("episodes", "published", "shared", "independent")]
        table.add_row(
            row["task"], f"{row['study']} {row['variant']}", str(row["seed"]), sampling, *counts, differ
        )
    console.print(table)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--folder", type=Path, default=Path("outputs/benchmarks"), help="of the studies' folders"
    )
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/episode_draws.json"))
    args = parser.parse_args()
    published = json.loads(BEFORE.read_text())
    rows = []
    for study in VARIANTS:
        for path in sorted((args.folder / study).glob("*/*/seed_*/*.json")):
            if path.name != "training.json" and (row := compare(path, study, published)) is not None:
                rows.append(row)
                args.out.write_text(json.dumps(rows, indent=1) + "\n")
    show(rows, Console(width=160))


if __name__ == "__main__":
    main()
