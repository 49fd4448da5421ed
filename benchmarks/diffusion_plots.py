"""The picture and the tables of docs/policies/diffusion.md, from what benchmarks/diffusion_success.py wrote.

    python benchmarks/diffusion_plots.py

reads benchmarks/results/diffusion_*.json, draws docs/images/diffusion_steps.png and prints the tables in
Markdown.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path

from diffusion_variants import EARLY, STUDIES
from execution_plots import draw_rate, save
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from policy_study import HEADER, Cell, Run, row

COLORS = {
    "euler": "tab:blue",
    "midpoint": "tab:cyan",
    "heun": "tab:green",
    "ddim": "tab:red",
    "dpm++": "tab:orange",
    "ddpm": "tab:brown",
}
GROUPS = {
    "flow, a fifth of the training": lambda run: run.variant == "recipe" and run.checkpoint == EARLY,
    "flow": lambda run: run.variant == "recipe" and run.checkpoint == "last",
    "ddpm": lambda run: run.variant != "recipe",
}


def read(results: Path, study: str) -> list[Cell]:
    path = results / f"diffusion_{study}.json"
    return [Cell(**each) for each in json.loads(path.read_text())] if path.exists() else []


def curves(cells: list[Cell]) -> dict[tuple[str, str], list[Cell]]:
    """The cells of each group and sampler, by rising number of network calls."""
    found: dict[tuple[str, str], list[Cell]] = {}
    for cell in sorted(cells, key=lambda cell: cell.network_calls):
        run = Run(**cell.run)
        (group,) = [name for name, belongs in GROUPS.items() if belongs(run)]
        found.setdefault((group, run.sampling["sampler"]), []).append(cell)
    return found


def draw_steps(cells: list[Cell], path: Path) -> None:
    """Success, jerk and milliseconds over network calls per chunk."""
    figure = Figure(figsize=(15, 4.6), layout="constrained")
    title = f"{cells[0].run['task']}, {cells[0].episodes} episodes"
    success, jerk, cost = figure.subplots(1, 3)
    styles = dict(zip(GROUPS, ("--", "-", ":"), strict=True))
    for (group, sampler), line in curves(cells).items():
        style = {"color": COLORS[sampler], "linestyle": styles[group], "label": f"{sampler}, {group}"}
        rates = [(cell.network_calls, cell.rate) for cell in line]
        draw_rate(success, rates, **style)
        draw(jerk, line, lambda cell: cell.smoothness.get("rms_jerk"), **style)
        if group != "flow, a fifth of the training":
            draw(cost, line, lambda cell: cell.chunk_ms, **style)
    success.set(ylabel="success [%]", ylim=(-3, 103), title=title)
    jerk.set(ylabel="rms jerk of the arms [std / s³]", title="smoothness of successful episodes")
    cost.set(ylabel="CPU time [ms]", title="one chunk, one core")
    for ax in (jerk, cost):
        ax.set_ylim(bottom=0)
    for ax in (success, jerk, cost):
        ax.set_xscale("log")
        ax.set_xticks([1, 2, 3, 5, 10, 20], ["1", "2", "3", "5", "10", "20"])
        ax.minorticks_off()
        ax.set(xlabel="network calls per chunk")
        ax.grid(alpha=0.3)
    success.legend(fontsize=8, loc="lower right")
    save(figure, path)


def draw(ax: Axes, cells: list[Cell], value: Callable[[Cell], float | None], **style: str) -> None:
    points = [(cell.network_calls, value(cell)) for cell in cells]
    points = [(calls, y) for calls, y in points if y is not None]
    ax.plot([x for x, _ in points], [y for _, y in points], marker="o", markersize=4, linewidth=1.5, **style)


def print_table(cells: list[Cell]) -> None:
    for line in (HEADER, ["---"] * len(HEADER), *map(row, cells)):
        print("|", " | ".join(line), "|")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--results", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--images", type=Path, default=Path("docs/images"))
    args = parser.parse_args()
    for study in STUDIES:
        cells = read(args.results, study)
        print(f"\n### {study}\n")
        print_table(cells)
        if study == "steps" and cells:
            draw_steps(cells, args.images / "diffusion_steps.png")


if __name__ == "__main__":
    main()
