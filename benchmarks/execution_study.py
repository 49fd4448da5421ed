"""Chunk execution, success, smoothness and network calls: the tables of docs/studies/execution-study.md.

    python benchmarks/execution_study.py [--tasks transfer_cube insertion] [--episodes 200]

One quickstart policy per task (recorded and trained first if it is not there yet) acts under every mode,
replanning interval and weighting below, always on the same episodes: fully trained; fully trained, but the
object is pushed before it is grasped; and from the checkpoint after a fifth of the training, where nothing is
saturated. Every evaluation is written down when it
is done, so the study can be stopped and gone on with, and tasks may run side by side in two processes.
"""

import argparse
import json
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from lerobot_act_chunking.cli.quickstart import LOCAL_HUB, QuickstartPlan, run
from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate, mcnemar
from lerobot_act_chunking.durable_files import write_atomically
from lerobot_act_chunking.envs.aloha.tasks import JOINT_NAMES, TASKS

FIRST_SEED = 1000  # lerobot-eval's
CHECKPOINTS = ("004000", "000800")
GRIPPERS = [6, 13]
PUSH_STEP, PUSH_M = 40, 0.03
CONDITIONS = (("004000", 0.0), ("004000", PUSH_M), ("000800", 0.0))
"""Checkpoint, and length of the push [m]."""
FEWEST_SUCCESSES = 20
"""Smoothness is that of successful episodes, and of no fewer than these."""

Execution = dict[str, Any]


def executions(checkpoint: str) -> Iterator[Execution]:
    """Every way of executing chunks of 100 that is compared; fewer of them for the early checkpoint."""
    trained = checkpoint == CHECKPOINTS[0]
    yield {"execution": "open_loop"}
    for interval in (1, 5, 10, 25, 50):
        yield {"execution": "receding", "replan_interval": interval}
    for interval in (1, 10, 25, 50):
        yield ensemble(interval, "act", 0.01)
    yield from (ensemble(interval, "recency", 0.1) for interval in (1, 25))
    yield {"execution": "crossfade", "replan_interval": 25, "crossfade_steps": 10}
    yield {"execution": "adaptive", "replan_interval": 10, "adaptive_kernel": "gate"}
    if not trained:
        return
    yield from (ensemble(interval, "act", 0.1) for interval in (1, 25))
    yield from (ensemble(interval, "recency", 0.01) for interval in (1, 25))
    for steps in (10, 25):
        yield {"execution": "crossfade", "replan_interval": 50, "crossfade_steps": steps}
    for kernel in ("cosine", "gaussian"):
        yield {"execution": "adaptive", "replan_interval": 10, "adaptive_kernel": kernel}
    yield {"execution": "adaptive", "replan_interval": 25, "adaptive_kernel": "gate"}
    yield {**ensemble(25, "act", 0.01), "gripper_dims": GRIPPERS}


def ensemble(interval: int, weighting: str, coeff: float) -> Execution:
    return {
        "execution": "ensemble",
        "replan_interval": interval,
        "ensemble_weighting": weighting,
        "temporal_ensemble_coeff": coeff,
    }


@dataclass(frozen=True)
class Cell:
    """One evaluation: a policy's checkpoint, an execution, a push [m], and what came of it."""

    task: str
    checkpoint: str
    execution: Execution
    episodes: int
    failed_seeds: list[int]
    mean_steps: float
    calls_per_episode: float
    smoothness: dict[str, float | None]
    push_m: float = 0.0

    @property
    def key(self) -> str:
        """What identifies the evaluation."""
        return cell_key(self.task, self.checkpoint, self.push_m, self.execution)

    @property
    def rate(self) -> SuccessRate:
        """The success rate."""
        return SuccessRate(self.episodes - len(self.failed_seeds), self.episodes)


def cell_key(task: str, checkpoint: str, push_m: float, execution: Execution) -> str:
    return f"{task} {checkpoint} {'pushed ' if push_m else ''}{label(execution)}"


def label(execution: Execution) -> str:
    """An execution in a table's first column."""
    details = {name: str(value) for name, value in execution.items()}
    details["replan_interval"] = f"R={execution.get('replan_interval', 100)}"
    if "gripper_dims" in details:
        details["gripper_dims"] = "(grippers: newest)"
    return " ".join(details.values())


def prepare(plan: QuickstartPlan, console: Console) -> None:
    """Record and train as the quickstart does, unless that was done before."""
    os.environ[LOCAL_HUB] = str(plan.hub)
    if not plan.recorded():
        run(plan.record_command(), console)
    if not (plan.train / "checkpoints" / f"{plan.steps:06d}").exists():
        run(plan.train_command(), console)


def configure(policy: Any, execution: Execution) -> None:
    """Let a loaded policy execute its chunks of 100 in another way from the next rollout on."""
    defaults = {
        **dict.fromkeys(("replan_interval", "temporal_ensemble_coeff", "ensemble_weighting"), None),
        **dict.fromkeys(("crossfade_steps", "adaptive_kernel", "adaptive_scale"), None),
        "latency_steps": 0,
        "gripper_dims": [],
        "n_action_steps": policy.config.chunk_size,
    }
    for name, value in {**defaults, **execution}.items():
        setattr(policy.config, name, value)
    policy.reset()


def evaluate(
    loaded: Any, task: str, checkpoint: str, push_m: float, execution: Execution, **options: Any
) -> Cell:
    """Run the episodes of one cell and measure them."""
    from lerobot_act_chunking.diagnostics.bandwidth.push import push_object
    from lerobot_act_chunking.diagnostics.core.environments import environment_of, task_environment
    from lerobot_act_chunking.diagnostics.core.rollouts import roll_out

    configure(loaded.policy, execution)
    env_config = environment_of(loaded.policy.config, task_environment(task, "touch"))
    episodes = options.pop("episodes")
    seeds = range(FIRST_SEED, FIRST_SEED + episodes)
    on_step = push_object(PUSH_STEP, push_m) if push_m else None
    rollouts = roll_out(loaded, env_config, seeds, n_envs=100, on_step=on_step, **options)
    succeeded = [rollout for rollout in rollouts if rollout.success]
    return Cell(
        task=task,
        checkpoint=checkpoint,
        execution=execution,
        episodes=episodes,
        failed_seeds=[rollout.seed for rollout in rollouts if not rollout.success],
        mean_steps=sum(len(rollout.commands) for rollout in rollouts) / episodes,
        calls_per_episode=sum(len(rollout.inferences) for rollout in rollouts) / episodes,
        smoothness=smoothness(succeeded, loaded) if len(succeeded) >= FEWEST_SUCCESSES else {},
        push_m=push_m,
    )


def smoothness(
    rollouts: list[Any], loaded: Any, names: Sequence[str] = JOINT_NAMES
) -> dict[str, float | None]:
    """The arms' commanded motion in a few numbers."""
    from lerobot_act_chunking.diagnostics.smoothness.measuring import measure
    from lerobot_act_chunking.diagnostics.smoothness.sources import action_std

    report = measure(rollouts, action_std=action_std(loaded), joint_names=names)
    disagreement = report.disagreement
    return {
        **asdict(report.commanded.arms),
        "boundary_to_plan_ratio": report.boundary_to_plan_ratio.get("arms"),
        "tracking_lag_s": report.tracking_lag_s.get("arms"),
        "mean_disagreement": None if disagreement is None else disagreement.mean_arms,
    }


class Results:
    """A task's finished cells, on disk as soon as they are known."""

    def __init__(self, path: Path):
        self.path = path
        stored = json.loads(path.read_text()) if path.exists() else []
        self.cells = {cell.key: cell for cell in (Cell(**each) for each in stored)}

    def add(self, cell: Cell) -> None:
        self.cells[cell.key] = cell
        write_atomically(self.path, json.dumps([asdict(each) for each in self.cells.values()]).encode())


def study(plan: QuickstartPlan, episodes: int, console: Console) -> list[Cell]:
    """All cells of one task."""
    from lerobot_act_chunking.policies.loading import load_policy

    results = Results(plan.folder / f"cells_{episodes}.json")
    cells = []
    for checkpoint, push_m in CONDITIONS:
        loaded = None
        for execution in executions(checkpoint):
            key = cell_key(plan.task, checkpoint, push_m, execution)
            if key not in results.cells:
                path = plan.train / "checkpoints" / checkpoint / "pretrained_model"
                loaded = loaded or load_policy(path)
                started = time.monotonic()
                with Progress(console=console, transient=True) as bar:
                    bar_id = bar.add_task(key, total=episodes)
                    results.add(
                        evaluate(
                            *(loaded, plan.task, checkpoint, push_m, execution),
                            episodes=episodes,
                            progress=lambda n, bar=bar, bar_id=bar_id: bar.update(bar_id, completed=n),
                        )
                    )
                console.print(f"{key}: {results.cells[key].rate} in {time.monotonic() - started:.0f} s")
            cells.append(results.cells[key])
    return cells


COLUMNS = {
    "boundary_ratio": "boundary",
    "boundary_to_plan_ratio": "boundary/plan",
    "rms_jerk": "jerk",
    "log_dimensionless_jerk": "LDLJ",
    "energy_above_5_hz": "> 5 Hz",
    "mean_disagreement": "disagreement",
}


def rows(cells: list[Cell]) -> Iterator[list[str]]:
    """The cells of one task and checkpoint, compared with its open loop."""
    open_loop = cells[0]
    for cell in cells:
        yield [
            label(cell.execution),
            f"{100 * cell.rate.rate:.1f}",
            cell.rate.percent,
            f"{mcnemar(cell.failed_seeds, open_loop.failed_seeds):.2g}",
            f"{cell.calls_per_episode:.1f}",
            *(_number(cell.smoothness.get(name)) for name in COLUMNS),
        ]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


HEADER = ["execution", "success %", "95 % Wilson", "paired p", "calls", *COLUMNS.values()]


def show(cells: list[Cell], console: Console) -> None:
    for task in dict.fromkeys(cell.task for cell in cells):
        for title, group in conditions(cells, task):
            table = Table(*HEADER, title=title)
            for row in rows(group):
                table.add_row(*row)
            console.print(table)


def conditions(cells: list[Cell], task: str) -> Iterator[tuple[str, list[Cell]]]:
    """The cells of one task by condition."""
    for checkpoint, push_m in CONDITIONS:
        group = [c for c in cells if (c.task, c.checkpoint, c.push_m) == (task, checkpoint, push_m)]
        yield f"{task}, {int(checkpoint)} training steps" + (", pushed" if push_m else ""), group


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tasks", nargs="+", default=list(TASKS))
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--folder", type=Path, default=Path("outputs/benchmarks/execution_study"))
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/execution_study.json"))
    args = parser.parse_args()
    console = Console(width=160)
    cells = []
    for task in args.tasks:
        plan = QuickstartPlan(args.folder / task, task)
        prepare(plan, console)
        cells += study(plan, args.episodes, console)
    show(cells, console)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps([asdict(cell) for cell in cells]) + "\n")
    console.print(f"written: {args.out}")


if __name__ == "__main__":
    main()
