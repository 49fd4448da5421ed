"""Whether anything that the benchmarks time got slower since an earlier revision.

The committed benchmarks run there (in a worktree) and here, in turns, with the same versions of everything
else. Each compares with a reference in the same run (LeRobot's code, gym-aloha, copying files), so both
revisions are compared by their time as a share of it, which does not depend on how busy the machine is.
Printed are the medians over the turns and their ratio, here / there (below 1: faster now).

    python benchmarks/revisions.py REVISION [--rounds 3] [--only policy] [--output revisions.json]
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[1]
Shares = dict[str, float]
"""What is timed, and our time divided by the reference's."""


def of_results(document: Any) -> Shares:
    """A list of comparisons, each with its case and quantity."""
    results = document["results"] if isinstance(document, dict) else document
    return {
        ", ".join(str(each[key]) for key in ("case", "other", "quantity", "batch_size") if key in each): each[
            "ratio"
        ]
        for each in results
    }


def of_reader(document: Any) -> Shares:
    """How many times faster than LeRobot's reader."""
    return {name: 1 / each["ratio"] for name, each in document["summary"].items() if "ratio" in each}


def of_environment(document: Any) -> Shares:
    """How many times faster than gym-aloha."""
    ours = {name: each for name, each in document["summary"].items() if not name.startswith("gym-aloha")}
    return {name: 1 / each["times_stock"] for name, each in ours.items()}


def of_hub(document: Any) -> Shares:
    """A push beside copying and hashing."""
    return {f"push, {name}": ratio for name, ratio in document["ratios"].items()}


class Benchmark(NamedTuple):
    """A script, its options, the one that names its JSON, and how that is read."""

    options: tuple[str, ...]
    output: str
    shares: Callable[[Any], Shares]


BENCHMARKS = {
    "policy": Benchmark(("--repeats", "5", "--threads", "1"), "--output", of_results),
    "diffusion_latency": Benchmark(("--repeats", "3", "--threads", "1"), "--output", of_results),
    "vqbet_latency": Benchmark(("--repeats", "3", "--threads", "1"), "--output", of_results),
    "dataset_reader": Benchmark(("--rounds", "3", "--threads", "1"), "--out", of_reader),
    "environment": Benchmark(
        (
            "--rounds",
            "3",
        ),
        "--out",
        of_environment,
    ),
    "local_hub": Benchmark(("--files", "3"), "--out", of_hub),
}


@contextmanager
def worktree(revision: str) -> Iterator[Path]:
    """The files of a revision, in a folder that is removed at the end."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "there"
        subprocess.run(
            ["git", "worktree", "add", "--quiet", "--detach", path, revision], cwd=ROOT, check=True
        )
        try:
            yield path
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", path], cwd=ROOT, check=True)


def run(name: str, tree: Path) -> Shares:
    """One run of a benchmark with the package and the scripts of this tree."""
    benchmark = BENCHMARKS[name]
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "result.json"
        command = [sys.executable, f"benchmarks/{name}.py", *benchmark.options, benchmark.output, str(output)]
        environment = os.environ | {"PYTHONPATH": str(tree)}
        subprocess.run(command, cwd=tree, env=environment, check=True, stdout=subprocess.DEVNULL)
        return benchmark.shares(json.loads(output.read_text()))


def compare(name: str, there: Path, rounds: int) -> list[dict[str, Any]]:
    """Medians of both revisions over turns that each begin with the other one."""
    shares: dict[Path, dict[str, list[float]]] = {there: defaultdict(list), ROOT: defaultdict(list)}
    for turn in range(rounds):
        for tree in (there, ROOT) if turn % 2 else (ROOT, there):
            for quantity, share in run(name, tree).items():
                shares[tree][quantity].append(share)
    if uncompared := shares[ROOT].keys() ^ shares[there].keys():
        print(f"{name:18} only in one of them: {'; '.join(sorted(uncompared))}", flush=True)
    rows = []
    for quantity in shares[ROOT].keys() & shares[there].keys():
        before, after = (statistics.median(shares[tree][quantity]) for tree in (there, ROOT))
        rows.append(
            {
                "benchmark": name,
                "quantity": quantity,
                "before": before,
                "after": after,
                "ratio": after / before,
                "ratios": [
                    b / a for a, b in zip(shares[there][quantity], shares[ROOT][quantity], strict=True)
                ],
            }
        )
    return sorted(rows, key=lambda row: -row["ratio"])


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare the committed benchmarks with an earlier revision.")
    parser.add_argument("revision", help="as git names it")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", nargs="*", choices=BENCHMARKS, default=list(BENCHMARKS))
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    rows = []
    with worktree(options.revision) as there:
        for name in options.only:
            found = compare(name, there, options.rounds)
            rows += found
            for row in found:
                of_turns = ", ".join(f"{ratio:.2f}" for ratio in row["ratios"])
                print(
                    f"{name:18} {row['quantity']:45} {row['before']:9.4f} -> {row['after']:9.4f}"
                    f"  {row['ratio']:5.2f}  ({of_turns})",
                    flush=True,
                )
            if options.output:  # after each: a long run that is stopped keeps what it has
                options.output.write_text(
                    json.dumps({"revision": options.revision, "results": rows}, indent=1) + "\n"
                )


if __name__ == "__main__":
    main()
