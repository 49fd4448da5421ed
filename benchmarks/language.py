"""Policies that are told what to do: whether they do it, in words of the training, in others, and misled.

    OMP_NUM_THREADS=1 MUJOCO_GL=egl nice -n 5 python benchmarks/language.py --policies act_chunked --seeds 0

200 demonstrations of `language_transfer` (three cubes, two directions: six goals), 3000 steps of 64, then 200
unseen episodes for each kind of instruction: words of the training (`seen`), held-out paraphrases (`unseen`),
and words for a goal drawn apart from the one that counts (`shuffled`, where one in six is right by chance).
`diffusion_chunked` acts with and without guidance. What is done is kept in --folder and not done again.
Writes benchmarks/results/language.json and the table of docs/guides/language.md (a test compares).
"""

import argparse
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mode_study import show_on
from policy_study import Run, act, load
from policy_training import Recording, Training, Variant
from rich.console import Console

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.durable_files import write_atomically

ROOT = Path(__file__).parents[1]
RESULTS, PAGE = ROOT / "benchmarks/results/language.json", ROOT / "docs/guides/language.md"
MARK = "<!-- language: python benchmarks/language.py -->"
TASK, FIRST_SEED, GROUP = "language_transfer", 1000, 50
KINDS = ("seen", "unseen", "shuffled")
TOLD = {"language_encoder": "minilm", "device": "cpu", "push_to_hub": False}
VARIANTS = {
    "act_chunked": Variant({"type": "act_chunked", **TOLD}, 3000, 64),
    "act_chunked_mean": Variant({"type": "act_chunked", "language_reading": "mean", **TOLD}, 3000, 64),
    "diffusion_chunked": Variant({"type": "diffusion_chunked", "language_dropout": 0.1, **TOLD}, 3000, 64),
}
GUIDED = {"diffusion_chunked": ({}, {"guidance_scale": 2.0})}


def measure(
    policy: str, seed: int, folder: Path, episodes: int, console: Console
) -> Iterator[dict[str, Any]]:
    """Train a policy, unless that was done before, and tell it what to do in every kind of words."""
    recording = Recording(folder, TASK, episodes=200)
    recording.record(console)
    training = Training(folder / policy / f"seed_{seed}", VARIANTS[policy], seed, recording)
    training.train(console)
    for sampling in GUIDED.get(policy, ({},)):
        for kind in KINDS:
            done = folder / policy / f"seed_{seed}_{kind}_{sampling.get('guidance_scale', 1.0):g}.json"
            if not done.exists():
                failures = follow(training, Run(TASK, policy, seed, sampling=sampling), kind, episodes)
                row = {
                    "policy": policy,
                    "guidance_scale": sampling.get("guidance_scale", 1.0),
                    "instructions": kind,
                    "training_seed": seed,
                    "episodes": episodes,
                    "failures": failures,
                    "train": training.facts,
                }
                write_atomically(done, json.dumps(row).encode())
            yield json.loads(done.read_text())


def follow(training: Training, asked: Run, kind: str, episodes: int) -> dict[str, int]:
    """How the episodes that failed did so, and how many of them."""
    from lerobot_act_chunking.diagnostics.core.environments import environment_of, task_environment

    loaded = load(training, asked)
    given = task_environment(TASK, "touch")
    spec = type(given)(given.type, {**given.arguments, "instructions": kind})
    env_config, seeds = environment_of(loaded.policy.config, spec), range(FIRST_SEED, FIRST_SEED + episodes)
    groups = [seeds[first : first + GROUP] for first in range(0, episodes, GROUP)]
    played = [each for group in groups for each in act(loaded, env_config, group)]
    found = Counter(each.failure or "no label" for each in played if not each.success)
    return dict(found) | ({"diverged": episodes - len(played)} if len(played) < episodes else {})


def table(rows: list[dict[str, Any]]) -> str:
    """Successes of every training seed, and the widest of their intervals."""
    if not rows:
        return "Not measured yet."
    lines = [
        "| policy | guidance | instructions | successes of 200, by training seed | 95 % intervals |",
        "|---|---|---|---|---|",
    ]
    groups: dict[tuple[Any, ...], list[SuccessRate]] = {}
    for row in rows:
        key = (row["policy"], row["guidance_scale"], row["instructions"])
        failed = sum(row["failures"].values())
        groups.setdefault(key, []).append(SuccessRate(row["episodes"] - failed, row["episodes"]))
    for (policy, scale, kind), rates in groups.items():
        low, high = min(each.interval[0] for each in rates), max(each.interval[1] for each in rates)
        counts = ", ".join(str(each.successes) for each in rates)
        lines.append(f"| `{policy}` | {scale:g} | {kind} | {counts} | {100 * low:.1f}-{100 * high:.1f} % |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--policies", nargs="+", choices=VARIANTS, default=["act_chunked", "diffusion_chunked"]
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--folder", type=Path, default=ROOT / "outputs/benchmarks/language")
    args = parser.parse_args()
    identity = ("policy", "guidance_scale", "instructions", "training_seed")
    found = {tuple(each[name] for name in identity): each for each in known()}
    for policy in args.policies:
        for seed in args.seeds:
            for row in measure(policy, seed, args.folder, args.episodes, Console(width=160)):
                found[tuple(row[name] for name in identity)] = row
                rows = sorted(found.values(), key=_order)
                write_atomically(RESULTS, (json.dumps(rows, indent=1) + "\n").encode())
                show_on(PAGE, MARK, table(rows))


def known() -> list[dict[str, Any]]:
    return json.loads(RESULTS.read_text()) if RESULTS.exists() else []


def _order(row: dict[str, Any]) -> tuple[Any, ...]:
    return row["policy"], row["guidance_scale"], KINDS.index(row["instructions"]), row["training_seed"]


if __name__ == "__main__":
    main()
