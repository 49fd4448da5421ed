"""What a push to a local hub costs beside copying, syncing and hashing the same files.

    python benchmarks/local_hub.py [--files 6] [--megabytes 200] [--out local_hub.json]

Both ways are timed in turns, in both orders, since the second finds a warm cache.
"""

import argparse
import hashlib
import json
import os
import resource
import shutil
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

from huggingface_hub import HfApi
from huggingface_hub.utils import disable_progress_bars
from rich.console import Console

from lerobot_act_chunking.hub.routing import route_to
from lerobot_act_chunking.hub.storage import LocalHub


def seconds(work: Callable[[], object]) -> tuple[float, float]:
    """Wall and processor time of ``work`` [s]."""
    usage, began = resource.getrusage(resource.RUSAGE_SELF), time.perf_counter()
    work()
    after = resource.getrusage(resource.RUSAGE_SELF)
    spent = after.ru_utime + after.ru_stime - usage.ru_utime - usage.ru_stime
    return time.perf_counter() - began, spent


def copy_and_hash(source: Path, target: Path) -> None:
    """What storing a file cannot do without: hash it, copy it, force it to disk."""
    with source.open("rb") as file:
        hashlib.file_digest(file, "sha256")
    shutil.copyfile(source, target)
    with target.open("rb") as file:
        os.fsync(file.fileno())


def measure(folder: Path, files: int, megabytes: int) -> dict[str, list[float]]:
    """Total wall and processor time of pushing, and of copying and hashing, ``files`` files."""
    route_to(LocalHub(folder / "hub"))
    api = HfApi()
    api.create_repo("me/act")
    totals = {"push": [0.0, 0.0], "copy and hash": [0.0, 0.0]}
    for number in range(files):
        source = folder / f"{number}.bin"
        with source.open("wb") as file:
            for _ in range(megabytes):
                file.write(os.urandom(1 << 20))
        os.sync()
        works = {
            "push": lambda path=source: api.upload_file(
                path_or_fileobj=path, path_in_repo="m", repo_id="me/act"
            ),
            "copy and hash": lambda path=source: copy_and_hash(path, path.with_suffix(".copy")),
        }
        for name in sorted(works, reverse=bool(number % 2)):
            for index, value in enumerate(seconds(works[name])):
                totals[name][index] += value
    return totals


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--files", type=int, default=6)
    parser.add_argument("--megabytes", type=int, default=200)
    parser.add_argument("--out", type=Path, default=Path("local_hub.json"))
    args = parser.parse_args()
    disable_progress_bars()
    warnings.simplefilter("ignore", DeprecationWarning)  # huggingface_hub's way of handing files to httpx

    with tempfile.TemporaryDirectory() as folder:
        totals = measure(Path(folder), args.files, args.megabytes)
    ratios = {
        clock: totals["push"][index] / totals["copy and hash"][index]
        for index, clock in enumerate(("wall", "processor"))
    }
    for clock, ratio in ratios.items():
        Console().print(f"{clock} time of a push: {ratio:.2f} x copying, syncing and hashing")
    args.out.write_text(json.dumps({"seconds": totals, "ratios": ratios}, indent=2) + "\n")


if __name__ == "__main__":
    main()
