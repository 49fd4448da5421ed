"""Success, motion and cost of the scripted experts over unseen seeds, clean and disturbed.

    python benchmarks/experts.py --episodes 500 --task transfer_cube [--out experts.json]

Each episode is planned and simulated without rendering. The disturbed rows (a fifth as many episodes) say how
wrong a policy trained on the expert may be: the expert believes each object somewhere else, its arms are
shaken by smooth noise, its grippers come late, or one arm comes late.
"""

import argparse
import json
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.envs.aloha.experts import ExpertOptions, plan
from lerobot_act_chunking.envs.aloha.success import SUCCESS_RULES, make_success_rule
from lerobot_act_chunking.envs.aloha.world import (
    CONTROL_PERIOD,
    TASKS,
    AlohaWorld,
    sample_object_pose,
    stock_generator,
)
from lerobot_act_chunking.envs.demonstration import correlated_noise

FIRST_SEED = 1_000_000  # far from the seeds anybody records or evaluates with
ARMS = [*range(6), *range(7, 13)]
GRIPPERS = [6, 13]
LEFT_ARM = [*range(7)]
Change = Callable[[np.ndarray, np.random.Generator], np.ndarray]


@dataclass(frozen=True)
class Condition:
    """How the expert's belief and its commands differ from the clean ones."""

    offset: float = 0.0  # [m] between the believed and the true position of each object
    change: Change = lambda commands, rng: commands


@dataclass
class Outcome:
    """What happened over the episodes of one condition."""

    successes: dict[str, int] = field(default_factory=lambda: dict.fromkeys(SUCCESS_RULES, 0))
    failed_seeds: list[int] = field(default_factory=list)
    hold_steps: list[int] = field(default_factory=list)
    cpu_seconds: list[float] = field(default_factory=list)
    actions: list[np.ndarray] = field(default_factory=list)


def shaken(scale: float) -> Change:
    def change(commands: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        noise = correlated_noise(commands.shape, scale, rng, period=CONTROL_PERIOD)
        noise[:, GRIPPERS] = 0
        return commands + noise

    return change


def late(columns: list[int], steps: int) -> Change:
    def change(commands: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        changed = commands.copy()
        changed[steps:, columns] = commands[:-steps, columns]
        changed[:steps, columns] = commands[0, columns]
        return changed

    return change


CONDITIONS = {
    "clean": Condition(),
    "objects 5 mm off": Condition(offset=0.005),
    "objects 10 mm off": Condition(offset=0.01),
    "arms shaken, 5 mrad": Condition(change=shaken(0.005)),
    "arms shaken, 10 mrad": Condition(change=shaken(0.01)),
    "grippers 8 steps late": Condition(change=late(GRIPPERS, 8)),
    "left arm 8 steps late": Condition(change=late(LEFT_ARM, 8)),
}


def misplaced(pose: np.ndarray, offset: float, rng: np.random.Generator) -> np.ndarray:
    believed = pose.copy()
    for position in believed.reshape(-1, 7)[:, :2]:
        angle = rng.uniform(0, 2 * np.pi)
        position += offset * np.array([np.cos(angle), np.sin(angle)])
    return believed


def run(world: AlohaWorld, condition: Condition, seed: int, outcome: Outcome) -> None:
    """Plan and simulate one episode, and enter it into ``outcome``."""
    begin = time.process_time()
    rng = np.random.default_rng(seed)
    pose = sample_object_pose(world.task, stock_generator(seed))
    planned = plan(world.task, misplaced(pose, condition.offset, rng), ExpertOptions(), rng)
    rules = {name: make_success_rule(name, world.task) for name in SUCCESS_RULES}
    hold_step = None
    world.reset(pose)
    for step, command in enumerate(condition.change(planned.commands, rng)):
        world.step(command)
        succeeded = {name: rule.update(world.contacts()) for name, rule in rules.items()}
        if succeeded["hold"] and hold_step is None:
            hold_step = step
    outcome.cpu_seconds.append(time.process_time() - begin)
    outcome.actions.append(planned.actions)
    for name, rule in rules.items():
        outcome.successes[name] += rule.succeeded
    if hold_step is None:
        outcome.failed_seeds.append(seed)
    else:
        outcome.hold_steps.append(hold_step)


def smoothness(plans: list[np.ndarray]) -> dict[str, float]:
    """Largest derivatives of the arm joints [rad/s^n], and the share of steps with hardly any motion."""
    peaks, idle = [], []
    for actions in plans:
        derivatives = [actions[:, ARMS]]
        for _ in range(3):
            derivatives.append(np.diff(derivatives[-1], axis=0) / CONTROL_PERIOD)
        peaks.append([np.abs(derivative).max() for derivative in derivatives[1:]])
        speeds = np.abs(np.diff(actions, axis=0)).max(axis=1) / CONTROL_PERIOD
        idle.append(float(np.mean(speeds < 0.05)))
    velocity, acceleration, jerk = np.max(peaks, axis=0).tolist()
    return {
        "max_velocity": velocity,
        "max_acceleration": acceleration,
        "max_jerk": jerk,
        "idle_share_max": max(idle),
    }


def summarise(outcome: Outcome) -> dict:
    episodes = len(outcome.cpu_seconds)
    rates = {name: SuccessRate(count, episodes) for name, count in outcome.successes.items()}
    return {
        "episodes": episodes,
        **{name: {"successes": rate.successes, "interval": rate.interval} for name, rate in rates.items()},
        "failed_seeds": outcome.failed_seeds,
        "hold_step_median": statistics.median(outcome.hold_steps) if outcome.hold_steps else None,
        "hold_step_max": max(outcome.hold_steps, default=None),
        "steps": len(outcome.actions[0]),
        "cpu_s_per_episode": statistics.mean(outcome.cpu_seconds),
        **smoothness(outcome.actions),
    }


def table(task: str, results: dict[str, dict]) -> Table:
    headers = [f"{rule}, % [95 % Wilson]" for rule in SUCCESS_RULES]
    shown = Table("condition", "episodes", *headers, "hold at step", title=task)
    for name, row in results.items():
        shown.add_row(name, str(row["episodes"]), *(rate(row, rule) for rule in SUCCESS_RULES), steps(row))
    return shown


def rate(row: dict, rule: str) -> str:
    low, high = row[rule]["interval"]
    return f"{100 * row[rule]['successes'] / row['episodes']:.1f} [{100 * low:.1f}, {100 * high:.1f}]"


def steps(row: dict) -> str:
    return f"{row['hold_step_median']:.0f}, last {row['hold_step_max']}" if row["hold_step_max"] else "never"


def measure(task: str, episodes: int) -> dict[str, dict]:
    world, results = AlohaWorld(task), {}
    for name, condition in CONDITIONS.items():
        count = episodes if name == "clean" else max(1, episodes // 5)
        outcome = Outcome()
        for seed in track(range(FIRST_SEED, FIRST_SEED + count), name):
            run(world, condition, seed, outcome)
        results[name] = summarise(outcome)
    return results


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", choices=TASKS, default="transfer_cube")
    parser.add_argument("--episodes", type=int, default=500)
    parser.add_argument("--out", type=Path, default=Path("experts.json"))
    arguments = parser.parse_args()

    results = measure(arguments.task, arguments.episodes)
    console, clean = Console(), results["clean"]
    console.print(table(arguments.task, results))
    console.print(
        f"{clean['steps']} steps; {clean['cpu_s_per_episode']:.3f} CPU s per episode, simulation included; "
        f"arm joints at most {clean['max_velocity']:.1f} rad/s, {clean['max_acceleration']:.1f} rad/s2, "
        f"{clean['max_jerk']:.0f} rad/s3; idle steps at most {clean['idle_share_max']:.1%}"
    )
    report = {
        "task": arguments.task,
        "machine": {"platform": platform.platform(), "mujoco": version("mujoco")},
        "results": results,
    }
    arguments.out.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
