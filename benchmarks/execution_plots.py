"""The pictures and tables of docs/studies/execution-study.md, from what the two studies wrote.

    python benchmarks/execution_plots.py

reads benchmarks/results/{execution_study,replanning_stall}.json, draws docs/images/{execution_study,
replanning_stall}.png and prints the tables in Markdown.
"""

import argparse
import json
import statistics
from collections.abc import Callable
from pathlib import Path
from typing import Any

from execution_study import HEADER, Cell, conditions, rows
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from replanning_stall import Stall, Trial

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate

NO_PAUSES = "transfer_cube, 4000 training steps"
CURVES: dict[str, tuple[str, Callable[[dict[str, Any]], bool]]] = {
    "newest chunk": (
        "tab:red",
        lambda execution: execution["execution"] in ("receding", "open_loop"),
    ),
    "ensemble, act 0.01": ("tab:blue", lambda execution: _is_ensemble(execution, "act", 0.01)),
    "ensemble, recency 0.1": ("tab:green", lambda execution: _is_ensemble(execution, "recency", 0.1)),
    "crossfade, 10 steps": ("tab:orange", lambda execution: execution.get("crossfade_steps") == 10),
    "adaptive, gate": ("tab:purple", lambda execution: execution.get("adaptive_kernel") == "gate"),
}


def _is_ensemble(execution: dict[str, Any], weighting: str, coeff: float) -> bool:
    wanted = {"execution": "ensemble", "ensemble_weighting": weighting, "temporal_ensemble_coeff": coeff}
    return wanted.items() <= execution.items() and "gripper_dims" not in execution


def interval(cell: Cell) -> int:
    return cell.execution.get("replan_interval", 100)


def draw_rate(ax: Axes, points: list[tuple[float, SuccessRate]], **style: Any) -> None:
    """Success rates [%] with their Wilson intervals."""
    points = sorted(points, key=lambda point: point[0])
    x = [each for each, _ in points]
    y = [100 * rate.rate for _, rate in points]
    bounds = [rate.interval for _, rate in points]
    low = [max(0.0, a - 100 * b[0]) for a, b in zip(y, bounds, strict=True)]
    high = [max(0.0, 100 * b[1] - a) for a, b in zip(y, bounds, strict=True)]
    ax.errorbar(x, y, yerr=[low, high], marker="o", markersize=4, capsize=2, linewidth=1.5, **style)


def replan_axis(ax: Axes) -> None:
    ax.set_xscale("log")
    ax.set_xticks([1, 5, 10, 25, 50, 100], ["1", "5", "10", "25", "50", "100"])
    ax.minorticks_off()
    ax.set(xlabel="replan interval R [steps of 20 ms]")
    ax.grid(alpha=0.3)


def draw_study(cells: list[Cell], path: Path) -> None:
    """A row for each task: success in the three conditions, and how chunk boundaries look."""
    tasks = list(dict.fromkeys(cell.task for cell in cells))
    figure = Figure(figsize=(16, 4 * len(tasks)), layout="constrained")
    axes = figure.subplots(len(tasks), 4, squeeze=False)
    for row, task in zip(axes, tasks, strict=True):
        for ax, (title, group) in zip(row, conditions(cells, task), strict=False):
            for name, (color, belongs) in CURVES.items():
                points = [(interval(c), c.rate) for c in group if belongs(c.execution)]
                draw_rate(ax, points, color=color, label=name)
            replan_axis(ax)
            ax.set(title=title, ylabel="success [%]", ylim=(-3, 103))
        (_, trained), *_ = conditions(cells, task)
        draw_boundaries(row[3], trained)
    axes[0, 1].legend(fontsize=8)
    save(figure, path)


def draw_boundaries(ax: Axes, cells: list[Cell]) -> None:
    """The executed step into a new chunk, over the step which that chunk itself plans next."""
    for color, belongs in CURVES.values():
        ratios = [
            (interval(c), c.smoothness.get("boundary_to_plan_ratio")) for c in cells if belongs(c.execution)
        ]
        known = sorted((R, ratio) for R, ratio in ratios if ratio is not None)
        ax.plot(*zip(*known, strict=True), marker="o", markersize=4, color=color)
    ax.axhline(1, color="black", linewidth=0.8)
    replan_axis(ax)
    ax.set(
        ylabel="step at boundaries / planned step",
        ylim=(0, None),
        title="boundaries (1 is seamless), trained",
    )


def draw_stall(trials: list[Trial], cells: list[Cell], path: Path) -> None:
    figure = Figure(figsize=(15, 4.4), layout="constrained")
    pauses, lookahead, plans = figure.subplots(1, 3)
    without = [c for title, group in conditions(cells, "transfer_cube") for c in group if title == NO_PAUSES]
    points = [(interval(c), c.rate) for c in without if CURVES["newest chunk"][1](c.execution)]
    draw_rate(pauses, points, color="tab:gray", label="no pauses")
    for pause, color in zip((0.2, 0.5, 1.0), ("tab:cyan", "tab:blue", "tab:purple"), strict=True):
        points = [(t.replan_interval, t.rate) for t in trials if t.pause_s == pause and not t.lookahead]
        draw_rate(pauses, points, color=color, label=f"pauses of {pause:g} s")
    replan_axis(pauses)
    pauses.set(title="transfer_cube, demonstrations with pauses", ylabel="success [%]", ylim=(-3, 103))
    pauses.legend(fontsize=8)
    groups = dict.fromkeys((t.task, t.pause_s, t.training_steps) for t in trials if t.lookahead)
    for group, color in zip(groups, ("tab:orange", "tab:blue", "tab:green"), strict=False):
        members = [
            t for t in trials if (t.task, t.pause_s, t.training_steps) == group and t.replan_interval == 1
        ]
        name = f"{group[0]}, {group[2]} training steps" + (f", pauses of {group[1]:g} s" if group[1] else "")
        draw_rate(lookahead, [(t.lookahead, t.rate) for t in members], color=color, label=name)
        draw_plan(plans, members, color)
    lookahead.set(
        xlabel="action of the newest chunk that is carried out, R=1",
        ylabel="success [%]",
        ylim=(-3, 103),
        title="replanning at every step, looking ahead",
    )
    lookahead.grid(alpha=0.3)
    lookahead.legend(fontsize=8)
    plans.set(
        xlabel="action of the chunk [steps of 20 ms]",
        ylabel="distance from the pose over the arms [rad]",
        title="stalled: the plan (dotted: demonstrated)",
    )
    plans.set_xscale("symlog", linthresh=1)
    plans.set_yscale("log")
    plans.grid(alpha=0.3)
    save(figure, path)


def draw_plan(ax: Axes, trials: list[Trial], color: str) -> None:
    for trial in trials:
        if trial.stall is not None:
            steps = range(len(trial.stall.plan))
            ax.plot(steps, trial.stall.plan, color=color)
            ax.plot(steps, trial.stall.demonstrated, color=color, linestyle=":")


def save(figure: Figure, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    print(f"picture: {path}")


def markdown(header: list[str], lines: list[list[str]]) -> str:
    table = [header, ["---"] * len(header), *lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in table)


def study_tables(cells: list[Cell]) -> str:
    parts = []
    for task in dict.fromkeys(cell.task for cell in cells):
        for title, group in conditions(cells, task):
            parts += [f"### {title}", markdown(HEADER, list(rows(group)))]
    return "\n\n".join(parts)


def stall_table(trials: list[Trial]) -> str:
    header = ["task", "pauses [s]", "training steps", "R", "action", "success %", "95 % Wilson", "stalled"]
    header += ["neighbours' steps (quartiles)", "far neighbours %"]
    lines = []
    for trial in trials:
        stall = trial.stall
        where = ["-", "-"]
        if stall is not None:
            where = ["/".join(f"{step:.0f}" for step in stall.frames), f"{100 * stall.far_share:.0f}"]
        lines.append(
            [
                *(trial.task, f"{trial.pause_s:g}", str(trial.training_steps), str(trial.replan_interval)),
                *(str(trial.lookahead), f"{100 * trial.rate.rate:.1f}", trial.rate.percent),
                *(str(trial.stalled), *where),
            ]
        )
    return markdown(header, lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--results", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--images", type=Path, default=Path("docs/images"))
    args = parser.parse_args()
    cells = [Cell(**each) for each in json.loads((args.results / "execution_study.json").read_text())]
    stored = json.loads((args.results / "replanning_stall.json").read_text())
    trials = [
        Trial(**{**each, "stall": each["stall"] and Stall(**each["stall"])}) for each in stored["trials"]
    ]
    draw_study(cells, args.images / "execution_study.png")
    draw_stall(trials, cells, args.images / "replanning_stall.png")
    print(study_tables(cells))
    print(stall_table(trials))
    for task, motion in stored["demonstrators"].items():
        speed = motion["speed"]
        slowest = min(range(10, len(speed)), key=speed.__getitem__)
        left, right = motion["grippers"][slowest]
        print(
            f"{task} demonstrator: {statistics.median(speed):.2g} rad per step (median), "
            f"{speed[slowest]:.2g} at its slowest step {slowest}, grippers at {left:.2f} and {right:.2f}"
        )


if __name__ == "__main__":
    main()
