"""The tables of README.md and of docs/studies/steady.md, from the committed results.

    python benchmarks/readme_tables.py

reads benchmarks/results and writes the tables between their marks; a test compares.
"""

import argparse
import json
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"

# Policy, its settings, the file of its results and the variant in it, and what the table calls its tasks.
ALOHA = {"transfer_cube": "transfer_cube", "insertion": "insertion"}
FETCH = {"FetchPickAndPlace-v4": "FetchPickAndPlace", "FetchPush-v4": "FetchPush"}
STEADY = (
    ("act_chunked", "default settings", "act_headline.json", "base", ALOHA),
    ("diffusion_chunked", "configs/diffusion.yaml", "diffusion_recipe.json", "recipe", ALOHA),
    ("vqbet_chunked", "configs/vqbet.yaml", "vqbet_recipe.json", "recipe", ALOHA),
)
PEOPLE = tuple(
    (policy, "ten people", "operators.json", f"{policy}_1500", ALOHA)
    for policy in ("act_chunked", "diffusion_chunked", "vqbet_chunked")
)
EVERYBODY = {"operator": "everybody", "demonstrations": 50, "execution": "as it comes"}
POLICIES = (
    *PEOPLE,
    ("act_chunked", "benchmarks/fetch.py", "fetch_policies.json", "act_chunked", FETCH),
    ("diffusion_chunked", "configs/fetch.yaml", "fetch_policies.json", "diffusion_chunked", FETCH),
    ("vqbet_chunked", "benchmarks/fetch.py", "fetch_policies.json", "vqbet_chunked", FETCH),
)
ONE_CAMERA = (("act_chunked", "configs/act_pixels.yaml", "act_pixels.json"),)
DONE = 4  # the stage of an episode in which the cube was handed over
# Equal sizes in both: what the row is called, its file, and where in it.
SPEED = (
    ("ACT, 512 wide, VAE: training step of 32", "policy.json", "state d512 vae", "training step"),
    ("the same: a new chunk", "policy.json", "state d512 vae", "select_action"),
    (
        "ACT, 128 wide, no dropout: training step of 64",
        "policy.json",
        "state d128 no dropout",
        "training step",
    ),
    ("ACT, 512 wide, one camera: training step of 4", "policy.json", "camera d512 vae", "training step"),
    ("the same: a new chunk", "policy.json", "camera d512 vae", "select_action"),
    ("U-Net of 4.6 M: a new chunk", "diffusion_latency.json", "same U-Net S", "chunk"),
    ("U-Net of 64 M: a new chunk", "diffusion_latency.json", "same U-Net L", "chunk"),
    ("U-Net of 249 M: a new chunk", "diffusion_latency.json", "same U-Net XL", "chunk"),
    ("VQ-BeT, one camera: a new chunk", "vqbet_latency.json", "LeRobot vqbet", "chunk is due"),
    ("the same: mean over control steps", "vqbet_latency.json", "LeRobot vqbet", "control step"),
    ("the same: training step of 8", "vqbet_latency.json", "LeRobot vqbet", "training step"),
)


def read(name: str) -> Any:
    return json.loads((RESULTS / name).read_text())


def success_row(what: str, task: str, runs: list[tuple[int, int, float]]) -> str:
    """A row for trainings with (successes, episodes, minutes of CPU time) each."""
    lows, highs = zip(*(SuccessRate(done, of).interval for done, of, _ in runs), strict=True)
    minutes = [f"{each(cpu for *_, cpu in runs):.1f}" for each in (min, max)]
    shown = "-".join(dict.fromkeys(minutes))
    successes = ", ".join(str(done) for done, *_ in runs)
    return f"| {what} | {task} | {successes} | {100 * min(lows):.1f}-{100 * max(highs):.1f} % | {shown} min |"


def success_rows(policies: Iterable[tuple[str, str, str, str, dict[str, str]]]) -> Iterator[str]:
    """The head of a table, and a row for each policy and task."""
    yield "| policy | task | successes of 200, by training seed | 95 % intervals | training, CPU time |"
    yield "|---|---|---|---|---|"
    for policy, settings, file, variant, tasks in policies:
        for task, name in tasks.items():
            rows = [
                row
                for row in read(file)
                if (row["run"]["task"], row["run"]["variant"], row["run"]["checkpoint"])
                == (task, variant, "last")
                and ("operator" not in row or EVERYBODY.items() <= row.items())
            ]
            runs = [
                (row["episodes"] - len(row["failed_seeds"]), row["episodes"], row["train"]["cpu_minutes"])
                for row in sorted(rows, key=lambda row: row["run"]["seed"])
            ]
            yield success_row(f"`{policy}`, {settings}", name, runs)


def success_table() -> Iterator[str]:
    yield from success_rows(POLICIES)
    for policy, settings, file in ONE_CAMERA:
        (row,) = (row for row in read(file)["policies"] if row["policy"] == policy)
        stages = list(row["stages"].values())
        run = (stages.count(DONE), len(stages), row["train"]["cpu_minutes"])
        yield success_row(f"`{policy}`, {settings}", "transfer_cube, one camera", [run])


def speed_table() -> Iterator[str]:
    yield "| the same work in both | LeRobot | here | ratio |"
    yield "|---|---|---|---|"
    for what, file, case, quantity in SPEED:
        content = read(file)
        rows = content["results"] if isinstance(content, dict) else content
        (row,) = (
            row for row in rows if (row.get("case", row.get("other")), row["quantity"]) == (case, quantity)
        )
        lerobot = row.get("lerobot_ms", row.get("other_ms"))
        yield f"| {what} | {milliseconds(lerobot)} | {milliseconds(row['ours_ms'])} | {row['ratio']:.2f} |"
    sample = read("dataset_reader.json")["summary"]["one sample"]
    lerobot, ours = sample["LeRobot_ms"], sample["fast_ms"]
    yield (
        f"| one sample of the dataset, 100 actions | {milliseconds(lerobot)} | {milliseconds(ours)} "
        f"| {ours / lerobot:.3f} |"
    )


def milliseconds(value: float) -> str:
    """Three digits at most."""
    return f"{value:.0f} ms" if value >= 100 else f"{value:.3g} ms"


def steady_table() -> Iterator[str]:
    yield from success_rows(STEADY)


README = ROOT / "README.md"
STUDY = ROOT / "docs" / "studies" / "steady.md"
TABLES = {README: {"success": success_table, "speed": speed_table}, STUDY: {"steady": steady_table}}


def with_tables(page: str, of: Path = README) -> str:
    """The page with its tables as the results have them."""
    for name, table in TABLES[of].items():
        block = (
            f"<!-- {name}: python benchmarks/readme_tables.py -->\n\n"
            + "\n".join(table())
            + "\n\n<!-- end -->"
        )
        pattern = rf"<!-- {name}: .*?<!-- end -->"
        page, found = re.subn(pattern, block.replace("\\", r"\\"), page, flags=re.S)
        if found != 1:
            raise SystemExit(f"{of.name} has {found} places for the table {name!r}, not one")
    return page


def main() -> None:
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    for page in TABLES:
        page.write_text(with_tables(page.read_text(), page))
        print(page)


if __name__ == "__main__":
    main()
