"""How long `act-chunking eval` takes for 200 state episodes of a small ACT on two cores.

    OMP_NUM_THREADS=1 python benchmarks/evaluation.py

runs the command for policies of the quickstart's size in `transfer_cube` with two worker processes, from the
start of the program to its end, and writes benchmarks/results/evaluation.json and the table of
docs/instruments/eval.md. Weights are the initial ones, so that no episode ends before its 400 steps. Wall
times are those of an idle machine only if nothing else runs; the load before is written down.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_act_chunking.durable_files import write_atomically
from lerobot_act_chunking.envs.configuration_envs import AlohaSimEnvConfig

ROOT = Path(__file__).parents[1]
RESULTS, PAGE = ROOT / "benchmarks/results/evaluation.json", ROOT / "docs/instruments/eval.md"
MARK, END = "<!-- seconds: python benchmarks/evaluation.py -->", "<!-- end -->"
WORKERS = 2
SMALL = {"chunk_size": 100, "dim_model": 128, "n_heads": 4, "n_encoder_layers": 2, "dropout": 0.0}
POLICIES: dict[str, dict[str, Any]] = {
    "act_chunked": {**SMALL, "actions_per_query": 5},
    "act": {**SMALL, "n_action_steps": 50, "dim_feedforward": 512, "use_vae": False},
}


def save(policy_type: str, folder: Path) -> Path:
    """An untrained policy that observes the state."""
    env = AlohaSimEnvConfig(obs_type="state")
    features = {env.features_map[key]: feature for key, feature in env.features.items()}
    action = features.pop("action")
    torch.manual_seed(0)
    config = PreTrainedConfig.get_choice_class(policy_type)(
        device="cpu",
        push_to_hub=False,
        input_features=features,
        output_features={"action": PolicyFeature(FeatureType.ACTION, action.shape)},
        **POLICIES[policy_type],
    )
    stats = {
        key: {"mean": torch.zeros(feature.shape), "std": torch.ones(feature.shape)}
        for key, feature in {**features, "action": action}.items()
    }
    for part in (
        get_policy_class(policy_type)(config),
        *make_pre_post_processors(config, dataset_stats=stats),
    ):
        part.save_pretrained(folder)
    return folder


def measure(policy_type: str, episodes: int, folder: Path) -> dict[str, Any]:
    """Seconds of the whole command, and the control steps that it has done."""
    checkpoint, numbers = save(policy_type, folder / policy_type), folder / f"{policy_type}.json"
    command = [
        str(Path(sys.executable).parent / "act-chunking"),
        "eval",
        str(checkpoint),
        "--task=transfer_cube",
    ]
    command += [
        f"--episodes={episodes}",
        f"--workers={WORKERS}",
        f"--output-dir={folder / 'out' / policy_type}",
    ]
    before, load, began = cpu_seconds(), os.getloadavg()[0], time.perf_counter()
    subprocess.run([*command, "--json", str(numbers)], check=True, stdout=subprocess.DEVNULL)
    wall, cpu = time.perf_counter() - began, cpu_seconds() - before
    (found,) = json.loads(numbers.read_text())["policies"]
    return {
        "policy": policy_type,
        "settings": POLICIES[policy_type],
        "episodes": found["episodes"],
        "median_seconds": found["median_seconds"],
        "workers": WORKERS,
        "cpus": os.cpu_count(),
        "load_before": round(load, 1),
        "wall_s": round(wall, 1),
        "cpu_s": round(cpu, 1),
    }


def cpu_seconds() -> float:
    """Of all processes that this one started and that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def table(rows: list[dict[str, Any]]) -> str:
    """The results in Markdown."""
    lines = [
        "| policy | episodes | each [s] | processes | CPU [s] | wall [s] | load before |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| `{each['policy']}` | {each['episodes']} | {each['median_seconds']:g} | {each['workers']} "
        f"| {each['cpu_s']:.0f} | {each['wall_s']:.0f} | {each['load_before']:g} |"
        for each in rows
    ]
    return "\n".join(lines)


def with_table(page: str, rows: list[dict[str, Any]]) -> str:
    """The page with the table between its marks."""
    before, rest = page.split(MARK)
    return f"{before}{MARK}\n\n{table(rows)}\n\n{END}{rest.split(END, 1)[1]}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--policies", nargs="+", choices=POLICIES, default=list(POLICIES))
    parser.add_argument("--json", type=Path, default=RESULTS)
    args = parser.parse_args()
    register_third_party_plugins()
    with tempfile.TemporaryDirectory() as folder:
        rows = [measure(each, args.episodes, Path(folder)) for each in args.policies]
    write_atomically(args.json, (json.dumps(rows, indent=1) + "\n").encode())
    if args.json == RESULTS:
        write_atomically(PAGE, with_table(PAGE.read_text(), rows).encode())


if __name__ == "__main__":
    main()
