"""Chunks that come late: success and chunk boundaries under delays, docs/guides/real-time-chunking.md.

    python benchmarks/real_time_chunking.py --task insertion --policy "8000 steps=PATH/pretrained_model"

A chunk that is computed from the observation at step s is executed from step s + delay on; until then the
older one continues. Each policy acts with every method and delay on the same episodes:

==============  =====================================================================================
naive           the new chunk replaces the old one
crossfade       the same, blended in linearly
rtc exact       the new chunk is guided towards the old one (arXiv 2506.07339)
rtc identity    the same as LeRobot computes it, without the network's Jacobian
prefix          the network is given the actions executed meanwhile (arXiv 2512.05964); for policies
                trained with ``prefix_steps``
==============  =====================================================================================

Every evaluation is written down when it is done, so the study can be stopped and gone on with. Without a
policy, only the picture is drawn and the tables are printed of what is there.
"""

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from execution_study import FEWEST_SUCCESSES, FIRST_SEED
from rich.console import Console

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.durable_files import write_atomically
from lerobot_act_chunking.envs.aloha.tasks import TASKS
from lerobot_act_chunking.errors import ActChunkingError

DELAYS = (0, 1, 2, 3, 4, 10)
N_ACTION_STEPS, REPLAN_INTERVAL = 50, 25
METHODS: dict[str, dict[str, Any]] = {
    "naive": {},
    "crossfade": {"execution": "crossfade", "crossfade_steps": 10},
    "rtc exact": {"warm_start": "rtc", "rtc_vjp": "exact"},
    "rtc identity": {"warm_start": "rtc", "rtc_vjp": "identity"},
    "prefix": {"warm_start": "prefix"},
}
TIMED_CHUNKS = 20
STAND_IN = 10_000  # to the seed of an episode that takes the place of one whose simulation diverged


@dataclass(frozen=True)
class Cell:
    """One evaluation.

    Attributes:
        policy: which policy.
        method: one of `METHODS`.
        delay: of every chunk [control steps].
        failed_seeds: of the episodes without success.
        diverged_seeds: those among them in which the commands broke the simulation.
        boundary_ratio: median step into a new chunk over the median step elsewhere, arms; 1 is seamless.
        boundary_to_plan_ratio: the same over the step that the new chunk plans next.
        rms_jerk: of the arms' commands [standard deviations / s^3].
        disagreement: rms distance between chunks' predictions for the same steps [standard deviations].
    """

    task: str
    policy: str
    method: str
    delay: int
    episodes: int
    failed_seeds: list[int]
    diverged_seeds: list[int] = field(default_factory=list)
    boundary_ratio: float | None = None
    boundary_to_plan_ratio: float | None = None
    rms_jerk: float | None = None
    disagreement: float | None = None

    @property
    def rate(self) -> SuccessRate:
        return SuccessRate(self.episodes - len(self.failed_seeds), self.episodes)


class Results:
    """All that is finished, on disk as soon as it is known."""

    def __init__(self, path: Path):
        self.path = path
        stored = json.loads(path.read_text()) if path.exists() else {"cells": [], "ms_per_chunk": {}}
        self.cells = [Cell(**each) for each in stored["cells"]]
        self.ms_per_chunk: dict[str, dict[str, float]] = stored["ms_per_chunk"]

    def __contains__(self, wanted: tuple[str, str, str, int]) -> bool:
        return any((c.task, c.policy, c.method, c.delay) == wanted for c in self.cells)

    def save(self) -> None:
        policies, methods = list(dict.fromkeys(cell.policy for cell in self.cells)), list(METHODS)
        self.cells.sort(key=lambda c: (c.task, policies.index(c.policy), methods.index(c.method), c.delay))
        self.path.parent.mkdir(parents=True, exist_ok=True)
        content = {"cells": [asdict(cell) for cell in self.cells], "ms_per_chunk": self.ms_per_chunk}
        write_atomically(self.path, (json.dumps(content) + "\n").encode())


def configure(policy: Any, method: str, delay: int) -> None:
    """Let a loaded policy act by this method, and its chunks come late, from the next rollout on."""
    settings = {
        "execution": "receding",
        "n_action_steps": N_ACTION_STEPS,
        "replan_interval": REPLAN_INTERVAL,
        "crossfade_steps": None,
        "latency_steps": delay,
        "warm_start": "none",
        **METHODS[method],
    }
    for name, value in settings.items():
        setattr(policy.config, name, value)
    policy.reset()


def evaluate(loaded: Any, task: str, policy: str, method: str, delay: int, episodes: int) -> Cell:
    """Run the episodes of one cell and measure them."""
    configure(loaded.policy, method, delay)
    rollouts, diverged = run_episodes(loaded, task, episodes)
    succeeded = [rollout for rollout in rollouts if rollout.success]
    return Cell(
        *(task, policy, method, delay, episodes),
        failed_seeds=sorted(diverged | {rollout.seed for rollout in rollouts if not rollout.success}),
        diverged_seeds=sorted(diverged),
        **(motion(succeeded, loaded, delay) if len(succeeded) >= FEWEST_SUCCESSES else {}),
    )


def run_episodes(loaded: Any, task: str, episodes: int) -> tuple[list[Any], set[int]]:
    """The episodes, and the seeds of those in which the simulation diverged.

    All are run again with another episode in such a one's place, so that the others keep their noise.
    """
    from lerobot_act_chunking.diagnostics.core.environments import environment_of, task_environment
    from lerobot_act_chunking.diagnostics.core.rollouts import roll_out

    env_config = environment_of(loaded.policy.config, task_environment(task, "touch"))
    seeds = list(range(FIRST_SEED, FIRST_SEED + episodes))
    under_way, diverged = [0], []
    while True:
        in_place = [seed + STAND_IN * diverged.count(seed) for seed in seeds]
        try:
            note = lambda seed, *_: under_way.__setitem__(0, seed)  # noqa: E731
            rollouts = roll_out(loaded, env_config, in_place, n_envs=100, on_step=note)
        except ActChunkingError:
            diverged.append(under_way[0] % STAND_IN)
        else:
            return [rollout for rollout in rollouts if rollout.seed in seeds], set(diverged)


def motion(rollouts: list[Any], loaded: Any, delay: int) -> dict[str, float | None]:
    """The arms' commanded motion and the chunks behind it in a few numbers."""
    from lerobot_act_chunking.diagnostics.smoothness.measuring import measure
    from lerobot_act_chunking.diagnostics.smoothness.sources import action_std

    report = measure(rollouts, action_std=action_std(loaded), latency_steps=delay)
    return {
        "boundary_ratio": report.commanded.arms.boundary_ratio,
        "boundary_to_plan_ratio": report.boundary_to_plan_ratio.get("arms"),
        "rms_jerk": report.commanded.arms.rms_jerk,
        "disagreement": None if report.disagreement is None else report.disagreement.mean_arms,
    }


def time_chunks(loaded: Any, task: str) -> dict[str, float]:
    """Median time of one chunk for one environment [ms]; methods take turns, so all see the same load."""
    from lerobot_act_chunking.diagnostics.core.environments import environment_of, task_environment
    from lerobot_act_chunking.diagnostics.core.rollouts import roll_out

    times: dict[str, list[float]] = {}
    env_config = environment_of(loaded.policy.config, task_environment(task, "touch"))
    prepare = loaded.policy._prepare
    for turn in range(TIMED_CHUNKS // 4 + 1):
        for method in usable_methods(loaded):
            configure(loaded.policy, method, 4)
            spent = times.setdefault(method, [])

            def timed(*args: Any, spent: list[float] = spent) -> Any:
                started = time.perf_counter()
                chunk = prepare(*args)()
                spent.append(1e3 * (time.perf_counter() - started))
                return lambda: chunk

            loaded.policy._prepare = timed
            roll_out(loaded, env_config, [FIRST_SEED + turn], n_envs=1)
            del loaded.policy._prepare
    return {method: round(median(spent), 2) for method, spent in times.items()}


def usable_methods(loaded: Any) -> list[str]:
    """Prefix conditioning must have been trained for."""
    return [method for method in METHODS if method != "prefix" or loaded.policy.config.prefix_steps]


def study(name: str, path: Path, args: argparse.Namespace, results: Results, console: Console) -> None:
    """All cells of one policy."""
    from lerobot_act_chunking.policies.loading import load_policy

    loaded = load_policy(path)
    for delay in args.delays:
        for method in usable_methods(loaded):
            if method not in args.methods or (args.task, name, method, delay) in results:
                continue
            started = time.monotonic()
            cell = evaluate(loaded, args.task, name, method, delay, args.episodes)
            results.cells.append(cell)
            results.save()
            spent = time.monotonic() - started
            console.print(f"{args.task}, {name}, {method}, delay {delay}: {cell.rate}, {spent:.0f} s")
    if f"{args.task}, {name}" not in results.ms_per_chunk:
        results.ms_per_chunk[f"{args.task}, {name}"] = time_chunks(loaded, args.task)
        results.save()


def tables(results: Results) -> Iterator[str]:
    """In Markdown, for every task and policy: success with its Wilson interval, and the boundaries."""
    for task, policy in dict.fromkeys((cell.task, cell.policy) for cell in results.cells):
        group = [cell for cell in results.cells if (cell.task, cell.policy) == (task, policy)]
        delays = sorted({cell.delay for cell in group})
        times = results.ms_per_chunk.get(f"{task}, {policy}", {})
        lines = [["method", *(f"d = {delay}" for delay in delays), "ms per chunk"]]
        lines.append(["---"] * len(lines[0]))
        for method in dict.fromkeys(cell.method for cell in group):
            found = {cell.delay: cell for cell in group if cell.method == method}
            ms = f"{times[method]:.1f}" if method in times else "-"
            lines.append([method, *(_entry(found.get(delay)) for delay in delays), ms])
        table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
        yield f"### {task}, {policy}\n\n{table}"


def _entry(cell: Cell | None) -> str:
    if cell is None:
        return "-"
    low, high = cell.rate.interval
    boundary = "-" if cell.boundary_ratio is None else f"{cell.boundary_ratio:.2f}"
    return f"{100 * cell.rate.rate:.1f} ({100 * low:.0f}-{100 * high:.0f}); {boundary}"


def draw(results: Results, path: Path) -> None:
    """A row for each task and policy: success, boundaries and jerk over the delay."""
    from execution_plots import draw_rate, save
    from matplotlib.figure import Figure

    groups = list(dict.fromkeys((cell.task, cell.policy) for cell in results.cells))
    if not groups:
        return
    figure = Figure(figsize=(14, 4 * len(groups)), layout="constrained")
    colors = dict(zip(METHODS, ("tab:red", "tab:orange", "tab:blue", "tab:cyan", "tab:green"), strict=True))
    for row, (task, policy) in zip(figure.subplots(len(groups), 3, squeeze=False), groups, strict=True):
        group = [cell for cell in results.cells if (cell.task, cell.policy) == (task, policy)]
        for i, method in enumerate(dict.fromkeys(cell.method for cell in group)):
            cells = [cell for cell in group if cell.method == method]
            style = {"color": colors[method], "label": method}
            shift = 0.06 * (i - 2)  # or intervals would hide each other
            draw_rate(row[0], [(cell.delay + shift, cell.rate) for cell in cells], **style)
            for ax, measure in ((row[1], "boundary_ratio"), (row[2], "rms_jerk")):
                known = [(c.delay, value) for c in cells if (value := getattr(c, measure)) is not None]
                ax.plot(*zip(*known, strict=True) if known else ((), ()), marker="o", markersize=4, **style)
        row[0].set(title=f"{task}, {policy}", ylabel="success [%]", ylim=(-3, 103))
        row[1].axhline(1, color="black", linewidth=0.8)
        row[1].set(
            ylabel="step at boundaries / step elsewhere",
            ylim=(0, None),
            title="chunk boundaries (1 is seamless)",
        )
        row[2].set(ylabel="rms jerk of the arms [std / s³]", ylim=(0, None), title="jerk of the commands")
        for ax in row:
            ax.set(xlabel="inference delay [steps of 20 ms]", xlim=(-0.5, max(DELAYS) + 0.5))
            ax.grid(alpha=0.3)
    figure.axes[0].legend(fontsize=8, loc="lower right")
    save(figure, path)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", choices=list(TASKS), default="insertion")
    parser.add_argument("--policy", action="append", default=[], metavar="NAME=PATH")
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS))
    parser.add_argument("--delays", nargs="+", type=int, default=list(DELAYS), help="[control steps]")
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/real_time_chunking.json"))
    parser.add_argument("--image", type=Path, default=Path("docs/images/real_time_chunking.png"))
    args = parser.parse_args()
    console, results = Console(width=160), Results(args.out)
    for each in args.policy:
        name, path = each.split("=", 1)
        study(name, Path(path), args, results, console)
    for table in tables(results):
        print(table, end="\n\n")
    draw(results, args.image)


if __name__ == "__main__":
    main()
