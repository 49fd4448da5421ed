"""What a longer cross-fade costs where the object is moved: success with a push, by execution.

    OMP_NUM_THREADS=1 python benchmarks/pushed.py outputs/train/cube/checkpoints/last/pretrained_model

The checkpoint is an `act_chunked` policy of transfer_cube. In each of 200 episodes the cube is pushed by 3 cm
at step 40, as in benchmarks/execution_study.py. Writes benchmarks/results/pushed.json.
"""

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from execution_study import FIRST_SEED, PUSH_M, PUSH_STEP, configure
from rich.console import Console
from rich.table import Table

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate

TASK, N_ENVS = "transfer_cube", 50
EXECUTIONS: dict[str, dict[str, Any]] = {
    **{
        f"crossfade 25 over {steps}": {
            "execution": "crossfade",
            "replan_interval": 25,
            "crossfade_steps": steps,
        }
        for steps in (10, 50, 75)
    },
    "ensemble 25": {"execution": "ensemble", "replan_interval": 25},
}


def successes(loaded: Any, execution: dict[str, Any], episodes: int) -> int:
    """How many of the pushed episodes succeed."""
    from lerobot_act_chunking.diagnostics.bandwidth.push import push_object
    from lerobot_act_chunking.diagnostics.core.environments import environment_of, task_environment
    from lerobot_act_chunking.diagnostics.core.rollouts import roll_out

    configure(loaded.policy, execution)
    env_config = environment_of(loaded.policy.config, task_environment(TASK, "touch"))
    seeds = range(FIRST_SEED, FIRST_SEED + episodes)
    groups = [seeds[first : first + N_ENVS] for first in range(0, episodes, N_ENVS)]
    push = push_object(PUSH_STEP, PUSH_M)
    rollouts = [roll_out(loaded, env_config, group, n_envs=len(group), on_step=push) for group in groups]
    return sum(each.success for group in rollouts for each in group)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/pushed.json"))
    args = parser.parse_args()
    from lerobot_act_chunking.policies.loading import load_policy

    loaded, table, entries = load_policy(args.checkpoint), Table("execution", "success %", "95 % Wilson"), []
    for name, execution in EXECUTIONS.items():
        rate = SuccessRate(successes(loaded, execution, args.episodes), args.episodes)
        low, high = rate.interval
        table.add_row(name, f"{100 * rate.rate:.1f}", f"{100 * low:.1f}-{100 * high:.1f}")
        entries.append({"execution": name, **asdict(rate)})
        args.out.write_text(json.dumps(entries, indent=1) + "\n")
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
