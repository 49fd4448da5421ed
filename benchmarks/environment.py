"""Environment steps per second beside gym-aloha, paired in one run.

    python benchmarks/environment.py [--rounds 5] [--steps 20] [--out environment.json]

Every round steps each environment, gym-aloha among them, through the start of one scripted transfer, so a
busy machine slows all of them; ratios are taken within a round. Each environment has its own process, because
dm_control takes its OpenGL context to be current for ever and would otherwise draw into another's.
"""

import argparse
import json
import os
import platform
import statistics
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from lerobot_act_chunking.envs.aloha.env import AlohaSimEnv
from lerobot_act_chunking.envs.aloha.experts import ExpertOptions, plan
from lerobot_act_chunking.envs.aloha.world import sample_object_pose, stock_generator

STOCK = "gym-aloha (three images)"
OURS = {
    "state": {},
    "one 640x480 camera, full": {"obs_type": "pixels_state"},
    "one 640x480 camera, fast": {"obs_type": "pixels_state", "render_quality": "fast"},
}
CHEAP_FACTOR = 10  # state steps are so short that more of them fit into a round


def make(name: str) -> gym.Env:
    if name == STOCK:
        from gym_aloha.env import AlohaEnv

        return AlohaEnv("transfer_cube", obs_type="pixels_agent_pos")
    return AlohaSimEnv(**OURS[name])


class Runner:
    """One environment in a process of its own."""

    environment: gym.Env

    def __init__(self, name: str, stack: ExitStack) -> None:
        pool = ProcessPoolExecutor(
            1, mp_context=get_context("spawn"), initializer=self._start, initargs=(name,)
        )
        self._pool = stack.enter_context(pool)

    def seconds_per_step(self, seed: int, actions: np.ndarray) -> float:
        return self._pool.submit(self._run, seed, actions).result()

    @classmethod
    def _start(cls, name: str) -> None:
        cls.environment = make(name)

    @classmethod
    def _run(cls, seed: int, actions: np.ndarray) -> float:
        cls.environment.reset(seed=seed)
        begin = time.perf_counter()
        for action in actions:
            cls.environment.step(action)
        return (time.perf_counter() - begin) / len(actions)


def measure(rounds: int, steps: int) -> dict[str, list[float]]:
    """Seconds per step of every environment in every round."""
    os.environ.setdefault("MUJOCO_GL", "egl")
    measured: dict[str, list[float]] = {name: [] for name in (STOCK, *OURS)}
    with ExitStack() as stack:
        runners = {name: Runner(name, stack) for name in measured}
        for seed in track(range(rounds + 1), "rounds"):
            pose = sample_object_pose("transfer_cube", stock_generator(seed))
            actions = plan("transfer_cube", pose, ExpertOptions(), np.random.default_rng(seed)).actions
            for name, runner in runners.items():
                count = steps * CHEAP_FACTOR if name == "state" else steps
                measured[name].append(runner.seconds_per_step(seed, actions[:count]))
    return {name: seconds[1:] for name, seconds in measured.items()}  # the first round warms up


def summarise(measured: dict[str, list[float]]) -> dict[str, dict[str, float]]:
    summary = {}
    for name, seconds in measured.items():
        ratios = [stock / own for stock, own in zip(measured[STOCK], seconds, strict=True)]
        summary[name] = {
            "ms_per_step": 1e3 * statistics.median(seconds),
            "steps_per_s": 1 / statistics.median(seconds),
            "times_stock": statistics.median(ratios),
            "times_stock_min": min(ratios),
            "times_stock_max": max(ratios),
        }
    return summary


def table(summary: dict[str, dict[str, float]]) -> Table:
    shown = Table("environment", "ms/step", "steps/s", "x gym-aloha", "range", title="environment steps")
    for name, row in summary.items():
        shown.add_row(
            name,
            f"{row['ms_per_step']:.3f}",
            f"{row['steps_per_s']:.1f}",
            f"{row['times_stock']:.1f}",
            f"{row['times_stock_min']:.1f} - {row['times_stock_max']:.1f}",
        )
    return shown


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument(
        "--steps", type=int, default=20, help="per environment and round; ten times for state"
    )
    parser.add_argument("--out", type=Path, default=Path("environment.json"))
    arguments = parser.parse_args()
    summary = summarise(measure(arguments.rounds, arguments.steps))
    Console().print(table(summary))
    versions = {name: version(name) for name in ("mujoco", "dm_control", "gym-aloha", "numpy")}
    machine = {"cpus": os.cpu_count(), "system": platform.platform(), "python": platform.python_version()}
    report = {"summary": summary, "rounds": arguments.rounds, "steps": arguments.steps}
    arguments.out.write_text(
        json.dumps({**report, "versions": versions, "machine": machine}, indent=2) + "\n"
    )


if __name__ == "__main__":
    main()
