"""The experts of the tasks with three equally valid ways: do they go the way they are told, and how fast?

    MUJOCO_GL=egl python benchmarks/planted_tasks.py

lets every operator go each way of `transfer_modes`, and the expert of `three_gates` each of its ways with
every option at its limit, over seeds that nobody records, and draws the ways. It writes
benchmarks/results/planted_tasks.json, docs/images/planted_tasks.png and the table of
docs/guides/planted-modes.md.
"""

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import asdict
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from mode_study import ROOT, show_on
from rich.console import Console
from rich.progress import track
from rich.table import Table

from lerobot_act_chunking.envs.demonstration import ExpertOptions
from lerobot_act_chunking.envs.operators import OPERATORS
from lerobot_act_chunking.envs.three_gates.expert import RANGES
from lerobot_act_chunking.recording import RecordSpec, SimulatedSource

PAGE = ROOT / "docs/guides/planted-modes.md"
MARK = "<!-- experts: python benchmarks/planted_tasks.py -->"
FIRST_SEED = 1_000_000  # far from the seeds anybody records or evaluates with
TASKS: dict[str, dict[str, Any]] = {
    "transfer_modes": {"task": "transfer_modes"},
    "three_gates": {"env": "three_gates"},
}
WAYS = {
    "transfer_modes": ("low on the left", "low on the right", "high"),
    "three_gates": ("up", "lower left", "lower right"),
}
CAMERAS = {"transfer_modes": "angle", "three_gates": "top"}


def source(task: str, mode: int, **options: Any) -> SimulatedSource:
    """Episodes that all go one way."""
    shares = tuple(100.0 * (way == mode) for way in range(len(WAYS[task])))
    return RecordSpec("local/ways", **TASKS[task], mode_shares=shares, **options).source()


def experts(task: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Who demonstrates a task, as fields of a recording."""
    if task == "transfer_modes":
        yield from ((name, {"operators": (name,)}) for name in OPERATORS)
        return
    usual = asdict(ExpertOptions())
    yield "as it comes", {}
    for name, limits in RANGES.items():
        for value in sorted(set(limits[:2]) - {usual[name]}):
            yield f"{name} {value:g}", {"expert": ExpertOptions(**{name: value})}


def measure(task: str, name: str, expert: dict[str, Any], attempts: int) -> dict[str, Any]:
    """Attempts of each way that the recorder would discard, and how many it plays a second."""
    discarded, start = [], time.process_time()
    for mode, way in enumerate(WAYS[task]):
        with source(task, mode, **expert).open() as play:
            seeds = track(range(FIRST_SEED, FIRST_SEED + attempts), f"{name}, {way}")
            discarded.append(sum(not play(seed).success for seed in seeds))
    seconds = time.process_time() - start
    return {
        "task": task,
        "expert": name,
        "attempts": attempts,
        "discarded": discarded,
        "attempts_per_cpu_second": len(discarded) * attempts / seconds,
    }


def separation(task: str) -> dict[str, list[float]]:
    """Distances between the ways' actions, and of each way from the mean of the two others (RMS)."""
    played = []
    for mode in range(len(WAYS[task])):
        with source(task, mode).open() as play:
            played.append(play(FIRST_SEED).arrays["action"])
    pairs = list(combinations(range(len(played)), 2))
    return {
        "between": [_rms(played[one] - played[other]) for one, other in pairs],
        "from_mean_of_others": [
            _rms(played[mode] - np.mean(played[:mode] + played[mode + 1 :], axis=0))
            for mode in range(len(played))
        ],
    }


def _rms(difference: np.ndarray) -> float:
    return float(np.sqrt(np.mean(difference**2)))


COLUMNS = ("task", "expert", "discarded of each way", "attempts of each", "attempts per CPU second")


def told(row: dict[str, Any]) -> list[str]:
    """A measurement for people."""
    counts, pace = ", ".join(map(str, row["discarded"])), f"{row['attempts_per_cpu_second']:.0f}"
    return [row["task"], row["expert"], counts, str(row["attempts"]), pace]


def table(rows: list[dict[str, Any]]) -> Table:
    shown = Table(*COLUMNS)
    for row in rows:
        shown.add_row(*told(row))
    return shown


def markdown(rows: list[dict[str, Any]]) -> str:
    lines = [list(COLUMNS), ["---"] * len(COLUMNS), *map(told, rows)]
    return "\n".join(f"| {' | '.join(each)} |" for each in lines)


def draw(out: Path) -> None:
    """One picture of each way: the hand-over, and the mass at every second step."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4.9), layout="constrained")
    axes = figure.subplots(2, 3)
    for row, (task, ways) in zip(axes, WAYS.items(), strict=True):
        for mode, (ax, way) in enumerate(zip(row, ways, strict=True)):
            ax.imshow(picture(task, mode))
            ax.set_title(f"{task}, mode {mode}: {way}", fontsize=9)
            ax.set_axis_off()
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=80)


def picture(task: str, mode: int) -> np.ndarray:
    """The frame at which the mode is decided; of the gates, the mass at all steps before it as well."""
    size = {"image_height": 240, "image_width": 320}
    of = source(task, mode, obs="pixels", cameras=(CAMERAS[task],), **size)
    frames = []
    with of.make_env() as env:
        for step in of.steps(env, FIRST_SEED):
            frames.append(step.observation["pixels"][CAMERAS[task]])
            if step.info["mode"] >= 0:
                break
    return np.min(frames[::2], axis=0) if task == "three_gates" else frames[-1]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tasks", nargs="+", choices=TASKS, default=list(TASKS))
    parser.add_argument("--attempts", type=int, default=100, help="of each way")
    parser.add_argument("--json", type=Path, default=Path("benchmarks/results/planted_tasks.json"))
    parser.add_argument("--out", type=Path, default=Path("docs/images/planted_tasks.png"))
    args = parser.parse_args()
    draw(args.out)
    rows = [measure(task, *expert, args.attempts) for task in args.tasks for expert in experts(task)]
    report = {"rows": rows, "separation": {task: separation(task) for task in args.tasks}}
    Console(width=120).print(table(rows), report["separation"])
    args.json.write_text(json.dumps(report, indent=1) + "\n")
    show_on(PAGE, MARK, markdown(rows))


if __name__ == "__main__":
    main()
