"""The picture and the tables of docs/guides/robotics.md, from what benchmarks/fetch.py wrote.

    python benchmarks/fetch_plots.py

reads benchmarks/results/fetch_*.json, draws docs/images/fetch_execution.png and prints the tables in
Markdown.
"""

import argparse
import json
from pathlib import Path

from execution_plots import draw_rate, markdown, save
from execution_study import FIRST_SEED
from fetch_variants import STUDIES, VARIANTS
from matplotlib.figure import Figure
from policy_study import HEADER, Cell, Run, row

COLORS = {5: "tab:red", 10: "tab:orange", 20: "tab:blue", 40: "tab:green"}
INTERVALS = (1, 2, 5, 10, 20)
FIRST_UNTOUCHED = 1100
"""The expert and the recipe were developed in the episodes before this one."""
SEEDS_HEADER = ["task", "policy", "each training seed", f"from episode {FIRST_UNTOUCHED} on"]


def read(results: Path, study: str) -> list[Cell]:
    path = results / f"fetch_{study}.json"
    return [Cell(**each) for each in json.loads(path.read_text())] if path.exists() else []


def chunk_size(cell: Cell) -> int:
    return VARIANTS[Run(**cell.run).variant].policy["chunk_size"]


def by_seed(cells: list[Cell]) -> list[list[str]]:
    """Rows: successes for each training seed, in all episodes and in those that nothing was developed on."""
    groups: dict[tuple[str, str], list[Cell]] = {}
    for cell in cells:
        groups.setdefault((cell.run["task"], cell.run["variant"]), []).append(cell)
    return [
        [*names, successes(group, FIRST_SEED), successes(group, FIRST_UNTOUCHED)]
        for names, group in groups.items()
    ]


def successes(cells: list[Cell], first: int) -> str:
    """Of each training, in the episodes from seed ``first`` on."""
    episodes = cells[0].episodes - (first - FIRST_SEED)
    counts = [episodes - sum(seed >= first for seed in cell.failed_seeds) for cell in cells]
    return f"{', '.join(map(str, counts))} of {episodes}"


def draw_execution(cells: list[Cell], path: Path) -> None:
    """Success over the interval of replanning, a line for each chunk length, a plot for each task."""
    tasks = sorted({cell.run["task"] for cell in cells})
    figure = Figure(figsize=(6 * len(tasks), 4.4), layout="constrained")
    for ax, task in zip(figure.subplots(1, len(tasks), sharey=True, squeeze=False)[0], tasks, strict=True):
        for index, (size, color) in enumerate(COLORS.items()):
            line = [cell for cell in cells if cell.run["task"] == task and chunk_size(cell) == size]
            shift = 1.02 ** (index - 1.5)  # so that intervals do not hide each other
            points = [(shift * (cell.run["sampling"]["replan_interval"] or size), cell.rate) for cell in line]
            draw_rate(ax, points, color=color, label=f"{size} steps")
        ax.set_xscale("log")
        ax.set_xticks(INTERVALS, [str(interval) for interval in INTERVALS])
        ax.minorticks_off()
        ax.set(title=f"{task}, 200 episodes", xlabel="replanning every … control steps of 40 ms")
        ax.set(ylabel="success at the last step [%]", ylim=(-3, 103))
        ax.grid(alpha=0.3)
        ax.legend(title="chunk", fontsize=8, loc="lower left")
    save(figure, path)


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
        print(markdown(list(HEADER), [row(cell) for cell in cells]))
        if study != "execution":
            print("\n" + markdown(SEEDS_HEADER, by_seed(cells)))
        if study == "execution" and cells:
            draw_execution(cells, args.images / "fetch_execution.png")


if __name__ == "__main__":
    main()
