"""What a push costs: memory is held to a limit, time is printed beside copying and hashing the same files."""

import hashlib
import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from huggingface_hub import HfApi

from lerobot_act_chunking.hub.storage import LocalHub

MEASURE = r"""
import re, sys, warnings
from pathlib import Path
warnings.simplefilter("ignore")
from huggingface_hub import HfApi
from lerobot_act_chunking.hub.routing import route_to
from lerobot_act_chunking.hub.storage import LocalHub
route_to(LocalHub(sys.argv[1]))
api = HfApi()
api.create_repo("me/act")
api.upload_file(path_or_fileobj=b"first" * 20000, path_in_repo="first", repo_id="me/act")
def kilobytes(key):
    return int(re.search(key + r":\s+(\d+)", Path("/proc/self/status").read_text())[1])
before = kilobytes("VmRSS")
api.upload_file(path_or_fileobj=sys.argv[2], path_in_repo="model.safetensors", repo_id="me/act")
print(kilobytes("VmHWM") - before)
"""


def memory_of_a_push(tmp_path: Path, size: int) -> float:
    """Peak memory of a process that pushes, above what it needed just before [MB].

    Not ``ru_maxrss``, which a child inherits from the process that started it.
    """
    if not Path("/proc/self/status").exists():
        pytest.skip("peak memory is read from /proc")
    source = tmp_path / "model.safetensors"
    with source.open("wb") as file:
        file.truncate(size)  # a file with a hole reads like any other
    command = [sys.executable, "-c", MEASURE, str(tmp_path / "hub"), str(source)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return int(done.stdout) / 1e3


def test_memory_does_not_grow_with_the_file(tmp_path: Path):
    assert memory_of_a_push(tmp_path, 100_000_000) < 50


@pytest.mark.slow
def test_two_gigabytes_need_less_than_200_megabytes(tmp_path: Path):
    needed = memory_of_a_push(tmp_path, 2_000_000_000)
    print(f"\npeak memory of a 2 GB push: {needed:.0f} MB above the process without it")
    assert needed < 200


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


@pytest.mark.slow
def test_the_time_of_a_push_beside_copying_and_hashing(hub: LocalHub, api: HfApi, tmp_path: Path):
    api.create_repo("me/act")
    totals = {"push": [0.0, 0.0], "copy and hash": [0.0, 0.0]}
    for number in range(6):
        source = tmp_path / f"{number}.bin"
        with source.open("wb") as file:
            for _ in range(200):
                file.write(os.urandom(1 << 20))
        os.sync()
        works = {
            "push": lambda path=source: api.upload_file(
                path_or_fileobj=path, path_in_repo="m", repo_id="me/act"
            ),
            "copy and hash": lambda path=source: copy_and_hash(path, path.with_suffix(".copy")),
        }
        for name in sorted(works, reverse=bool(number % 2)):  # both orders: the second finds a warm cache
            for index, value in enumerate(seconds(works[name])):
                totals[name][index] += value
    for index, clock in enumerate(("wall", "processor")):
        ratio = totals["push"][index] / totals["copy and hash"][index]
        print(f"\n{clock} time of a push: {ratio:.2f} x copying and hashing ({totals})")
