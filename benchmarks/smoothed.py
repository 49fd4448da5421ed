"""Whether a policy fails because its chunks jitter: success as it is, and with chunks that are smoothed.

    OMP_NUM_THREADS=1 python benchmarks/smoothed.py hesitant outputs/.../pretrained_model

Every chunk of the checkpoint, a policy of insertion that predicts every step, is replaced by its moving mean
(``smoothing_steps``); execution is otherwise as it comes. Adds to benchmarks/results/smoothed.json, under the
given name.
"""

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from execution_study import FIRST_SEED
from rich.console import Console

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate

TASK, N_ENVS = "insertion", 50
WINDOWS = (1, 5, 11)
"""Control steps that are averaged; 1 changes nothing."""


def successes(loaded: Any, window: int, episodes: int) -> int:
    """How many episodes succeed with chunks that are averaged over so many control steps."""
    from lerobot_act_chunking.diagnostics.core.environments import environment_of, task_environment
    from lerobot_act_chunking.diagnostics.core.rollouts import roll_out

    loaded.policy.config.smoothing_steps = window
    env_config = environment_of(loaded.policy.config, task_environment(TASK, "touch"))
    seeds = range(FIRST_SEED, FIRST_SEED + episodes)
    return sum(each.success for each in roll_out(loaded, env_config, seeds, n_envs=N_ENVS, log_chunks=False))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("name", help="who demonstrated")
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/smoothed.json"))
    args = parser.parse_args()
    from lerobot_act_chunking.policies.loading import load_policy

    loaded, console = load_policy(args.checkpoint), Console(width=100)
    there = json.loads(args.out.read_text()) if args.out.exists() else []
    entries = [each for each in there if each["name"] != args.name]
    for window in WINDOWS:
        rate = SuccessRate(successes(loaded, window, args.episodes), args.episodes)
        console.print(f"{args.name}: mean over {window} steps: {rate.successes} of {rate.episodes}")
        entries.append({"name": args.name, "window": window, **asdict(rate)})
        args.out.write_text(json.dumps(entries, indent=1) + "\n")


if __name__ == "__main__":
    main()
