"""The README's results table: the quickstart for several training seeds, and LeRobot's `act` for as long.

    python benchmarks/quickstart.py --seeds 0 1 2 --baseline --out benchmarks/results/quickstart.json

Each seed runs the very commands of `act-chunking quickstart` on one shared recording. The baseline is
LeRobot's own `act`, of the same size and learning rate, through lerobot-train with LeRobot's own reader
(ACT_CHUNKING_FAST_CHUNKS=0), stopped when it had as long as the slowest seed; its newest checkpoint counts.
"""

import argparse
import json
import os
import platform
import signal
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from lerobot_act_chunking.cli.quickstart import LOCAL_HUB, QuickstartPlan, run
from lerobot_act_chunking.diagnostics.core.eval_info import read_success_rate
from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate

BASELINE_POLICY = {
    "type": "act",
    "device": "cpu",
    "push_to_hub": "false",
    "chunk_size": "100",
    "n_action_steps": "50",
    "dim_model": "128",
    "n_heads": "4",
    "dim_feedforward": "512",
    "n_encoder_layers": "2",
    "use_vae": "false",
    "dropout": "0",
    "optimizer_lr": "1e-3",
}


@dataclass
class Row:
    """One line of the table."""

    policy: str
    task: str
    seed: int
    steps: int
    train_minutes: float
    successes: int
    episodes: int
    interval: tuple[float, float]


def timed(command: list[str], console: Console) -> float:
    started = time.monotonic()
    run(command, console)
    return (time.monotonic() - started) / 60


def evaluate(plan: QuickstartPlan, policy: str, steps: int, minutes: float, console: Console) -> Row:
    if not plan.evaluated():
        run(plan.eval_command(str(plan.checkpoint)), console)
    rate = read_success_rate(plan.evaluation / "eval_info.json")
    return Row(policy, plan.task, plan.seed, steps, minutes, rate.successes, rate.episodes, rate.interval)


def train_ours(plan: QuickstartPlan, console: Console) -> Row:
    os.environ[LOCAL_HUB] = str(plan.hub)
    minutes = timed(plan.train_command(), console)
    return evaluate(plan, "act_chunked", plan.steps, minutes, console)


def train_baseline(plan: QuickstartPlan, minutes: float, console: Console) -> Row:
    command = [
        str(Path(sys.executable).parent / "lerobot-train"),
        *(f"--policy.{name}={value}" for name, value in BASELINE_POLICY.items()),
        *(
            f"--dataset.repo_id={plan.repo_id}",
            f"--dataset.root={plan.dataset}",
            f"--output_dir={plan.train}",
        ),
        *(f"--seed={plan.seed}", "--steps=100000", "--save_freq=50", "--log_freq=50", "--batch_size=64"),
        *("--num_workers=0", "--env_eval_freq=0"),
    ]
    process = subprocess.Popen(command, env={**os.environ, "ACT_CHUNKING_FAST_CHUNKS": "0"})
    try:
        process.wait(timeout=60 * minutes)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGINT)
        process.wait()
    steps = int((plan.train / "checkpoints" / "last").resolve().name)
    return evaluate(plan, "LeRobot act", steps, minutes, console)


def show(rows: list[Row], console: Console) -> None:
    table = Table("policy", "task", "seed", "steps", "minutes", "success", "95 % Wilson")
    for row in rows:
        rate = SuccessRate(row.successes, row.episodes)
        success = f"{100 * rate.rate:.1f} % ({rate.successes}/{rate.episodes})"
        table.add_row(
            *(row.policy, row.task, str(row.seed), str(row.steps), f"{row.train_minutes:.1f}", success),
            f"{rate.percent} %",
        )
    console.print(table)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", default="transfer_cube")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--steps", type=int, default=QuickstartPlan.steps)
    parser.add_argument("--baseline", action="store_true", help="train LeRobot's act for as long, too")
    parser.add_argument("--folder", type=Path, default=Path("outputs/benchmarks/quickstart"))
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/quickstart.json"))
    args = parser.parse_args()
    console = Console()

    recording = QuickstartPlan(args.folder / args.task, args.task)
    if not recording.recorded():
        run(recording.record_command(), console)
    rows = []
    for seed in args.seeds:
        plan = SharedDataset(args.folder / args.task / f"seed_{seed}", args.task, steps=args.steps, seed=seed)
        rows.append(train_ours(plan, console))
        show(rows, console)
    if args.baseline:
        plan = SharedDataset(args.folder / args.task / "lerobot_act", args.task, seed=args.seeds[0])
        rows.append(train_baseline(plan, max(row.train_minutes for row in rows), console))
        show(rows, console)
    machine = {"cpu_count": os.cpu_count(), "processor": platform.processor() or platform.machine()}
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(
        json.dumps({"machine": machine, "rows": [asdict(row) for row in rows]}, indent=2) + "\n"
    )


class SharedDataset(QuickstartPlan):
    """A plan in a folder beside the others, on the recording they share and with a hub of its own."""

    @property
    def dataset(self) -> Path:
        return self.folder.parent / "dataset"

    @property
    def hub(self) -> Path:
        return (self.folder / "hub").resolve()


if __name__ == "__main__":
    main()
