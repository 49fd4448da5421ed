"""The simulated SO-101: how often its people succeed, what its pictures cost, and whether 30 Hz is kept.

    MUJOCO_GL=egl python benchmarks/so_arm.py [--episodes 40] [--seconds 20] [--parts people pictures loop]
    MUJOCO_GL=egl python benchmarks/so_arm.py --parts image   # docs/images/practice-arm.png

The results are in benchmarks/results/so_arm.json, one entry for each part that was asked for.
"""

import argparse
import json
import logging
import os
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from PIL import Image

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.envs.demonstration import ExpertOptions
from lerobot_act_chunking.envs.operators import OPERATORS
from lerobot_act_chunking.envs.rendering import OffscreenRenderer
from lerobot_act_chunking.envs.so_arm.env import FPS
from lerobot_act_chunking.envs.so_arm.experts import plan
from lerobot_act_chunking.envs.so_arm.options import CAMERAS
from lerobot_act_chunking.envs.so_arm.tasks import TASKS, get_task, sample_places
from lerobot_act_chunking.envs.so_arm.world import SoArmWorld
from lerobot_act_chunking.recording.spec import RecordSpec
from lerobot_act_chunking.robots.config_so_arm_sim import SoArmSimConfig
from lerobot_act_chunking.robots.config_so_arm_teleop import SoArmTeleopConfig
from lerobot_act_chunking.robots.so_arm_sim import SoArmSim
from lerobot_act_chunking.robots.so_arm_teleop import SoArmTeleop

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results" / "so_arm.json"
SIZES = ((480, 640), (240, 320))


def people(episodes: int) -> list[dict[str, Any]]:
    """Successes of every operator in every task; five times as many episodes of ``steady``.

    Each task has seeds of its own: with the same ones cube, habits and noise would be drawn alike, the same
    grasps would fail, and three tasks would say no more than one.
    """
    cases = [(task, who, episodes * (5 if who == "steady" else 1)) for task in TASKS for who in OPERATORS]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(_person, *zip(*cases, strict=True)))


def _person(task: str, operator: str, episodes: int) -> dict[str, Any]:
    source = RecordSpec("me/arm", env="so_arm_sim", task=task, operators=(operator,)).source()
    first = 10_000 * TASKS.index(task)
    failures, lengths = Counter[str](), []
    with closing(source.make_env()) as env:
        for seed in range(first, first + episodes):
            episode = source.play(env, seed)
            lengths.append(len(episode))
            if not episode.success:
                failures[env.get_wrapper_attr("failure") or "another way"] += 1
    successes = episodes - failures.total()
    return {
        "task": task,
        "operator": operator,
        "first_seed": first,
        "successes": successes,
        "episodes": episodes,
        "interval": list(SuccessRate(successes, episodes).interval),
        "failures": dict(failures),
        "steps": [min(lengths), int(median(lengths)), max(lengths)],
    }


def pictures(repeats: int = 100) -> list[dict[str, Any]]:
    """Median time [ms] of one picture, by camera, size and quality."""
    rows = []
    for quality in ("fast", "full"):
        world = _shown("pick_place", step=60)  # of its own: ``fast`` takes the shadows out of the model
        renderer = OffscreenRenderer(world.model, *SIZES[0], effects=quality == "full")
        for camera in CAMERAS:
            for size in SIZES:
                wall, cpu = [], []
                for _ in range(repeats):
                    begin, used = time.perf_counter(), time.process_time()
                    renderer.render(world.data, camera, *size)
                    wall.append(1000 * (time.perf_counter() - begin))
                    cpu.append(1000 * (time.process_time() - used))
                row = {"quality": quality, "camera": camera, "height": size[0], "width": size[1]}
                rows.append({**row, "wall_ms": round(median(wall), 2), "cpu_ms": round(median(cpu), 2)})
        renderer.close()
    return rows


def loop(seconds: float) -> dict[str, Any]:
    """Robot and operator at 30 Hz with two cameras of 480 x 640: how long a tick takes."""
    robot, teleop = SoArmSim(SoArmSimConfig()), SoArmTeleop(SoArmTeleopConfig())
    teleop.connect()
    robot.connect()
    robot.table.hear("Recording episode 0")  # what lerobot-record says: no demonstration follows by itself
    busy, gaps, seen = [], [], {name: set() for name in robot.cameras}
    begin, used, before = time.perf_counter(), time.process_time(), None
    for tick in range(round(FPS * seconds)):
        time.sleep(max(0.0, begin + tick / FPS - time.perf_counter()))
        start = time.perf_counter()
        observation = robot.get_observation()
        robot.send_action(teleop.get_action())
        busy.append(1000 * (time.perf_counter() - start))
        gaps += [] if before is None else [1000 * (start - before)]
        before = start
        for name, frames in seen.items():
            frames.add(observation[name].ctypes.data)
    span = time.perf_counter() - begin
    share = (time.process_time() - used) / span
    robot.disconnect()
    return {
        "seconds": round(span, 1),
        "busy_ms": {"median": median(busy), "p99": float(np.percentile(busy, 99)), "max": max(busy)},
        "period_ms": {"median": median(gaps), "p99": float(np.percentile(gaps, 99)), "max": max(gaps)},
        "cpu_cores": round(share, 2),
    }


def image() -> None:
    """Both cameras in each task, in the middle of a demonstration, as the documentation shows them."""
    rows = []
    for task, step in zip(TASKS, (112, 140, 70), strict=True):
        world = _shown(task, step)
        renderer = OffscreenRenderer(world.model, *SIZES[0], effects=False)
        views = [Image.fromarray(renderer.render(world.data, camera, *SIZES[0])) for camera in CAMERAS]
        renderer.close()
        rows.append([view.resize((320, 240), Image.Resampling.LANCZOS) for view in views])
    sheet = Image.new("RGB", (3 * 320 + 2 * 8, 2 * 240 + 8), "white")
    for column, views in enumerate(rows):
        for row, view in enumerate(views):
            sheet.paste(view, (column * 328, row * 248))
    sheet.save(ROOT / "docs" / "images" / "practice-arm.png", optimize=True)


def _shown(task: str, step: int) -> SoArmWorld:
    """A world as the expert has it after so many control steps."""
    world = SoArmWorld(task)
    places = sample_places(get_task(task), np.random.default_rng(1))
    world.reset(places)
    for command in plan(task, places, ExpertOptions(), np.random.default_rng(0)).commands[:step]:
        world.command(command)
        world.advance()
    return world


def main() -> None:
    """Measure what is asked for and write it down."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--episodes", type=int, default=40, help="of every person; five times as many of steady"
    )
    parser.add_argument("--seconds", type=float, default=20.0, help="for which the loop runs")
    parser.add_argument("--parts", nargs="+", default=["people", "pictures", "loop"])
    args = parser.parse_args()
    logging.basicConfig(level=logging.INFO)
    measure: dict[str, Callable[[], Any]] = {
        "people": lambda: people(args.episodes),
        "pictures": pictures,
        "loop": lambda: loop(args.seconds),
    }
    for part in args.parts:
        if part == "image":
            image()
            continue
        load = os.getloadavg()[0]  # of everything else: the machine may be shared
        measured = measure[part]()
        results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}  # others may have written
        results[part] = {"cpus": os.cpu_count(), "load_before": load, "measured": measured}
        print(json.dumps(results[part], indent=1))
        RESULTS.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
