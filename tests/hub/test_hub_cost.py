"""What a push costs in memory; its time is benchmarks/local_hub.py's."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tiers import full_tier

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


@full_tier
def test_two_gigabytes_need_less_than_200_megabytes(tmp_path: Path):
    needed = memory_of_a_push(tmp_path, 2_000_000_000)
    print(f"\npeak memory of a 2 GB push: {needed:.0f} MB above the process without it")
    assert needed < 200
