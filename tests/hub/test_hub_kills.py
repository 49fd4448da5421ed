"""kill -9 in the middle of pushes, and many pushers at once: processes of their own against one folder."""

import itertools
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from huggingface_hub import scan_cache_dir
from push_process import version_of
from tiers import full_tier

from lerobot_act_chunking.hub import garbage_collection
from lerobot_act_chunking.hub.names import RepoName
from lerobot_act_chunking.hub.repository import Repository
from lerobot_act_chunking.hub.storage import LocalHub
from lerobot_act_chunking.hub.verifying import verify

MODEL = RepoName("model", "me/act")
SCRIPT = Path(__file__).with_name("push_process.py")


def start(hub: LocalHub, name: str, first: int, count: int, size: int) -> subprocess.Popen[str]:
    folder = hub.root.with_name(f"pushed from {name}")
    folder.mkdir(exist_ok=True)
    file = str(folder / name)
    command = [sys.executable, "-W", "ignore", str(SCRIPT), str(hub.root), MODEL.repo_id, file]
    arguments = [*command, str(first), str(count), str(size)]
    environment = {
        **os.environ,
        "HF_HUB_DISABLE_PROGRESS_BARS": "1",
        "HF_HUB_OFFLINE": "1",
        "OMP_NUM_THREADS": "1",
    }
    return subprocess.Popen(
        arguments, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment
    )


def pushed(process: subprocess.Popen[str]) -> list[int]:
    with process:
        assert process.stdout is not None
        return [int(line.split()[1]) for line in process.stdout if line.startswith("pushed")]


def loaded_version(repository: Repository, size: int) -> int:
    head = repository.head("main")
    assert head is not None, "main names no revision"
    weights = repository.file(head, "model.safetensors")
    assert weights.stat().st_size == size
    with weights.open("rb") as file:
        return version_of(file.read(32))


def assert_kills_are_harmless(hub: LocalHub, kills: int, size: int) -> None:
    draw = random.Random(0)
    began = time.monotonic()
    assert pushed(start(hub, "model.safetensors", 0, 2, size)) == [0, 1]
    one_push = (time.monotonic() - began) / 2
    last = 1
    for _ in range(kills):
        process = start(hub, "model.safetensors", last + 1, 1000, size)
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        time.sleep(draw.uniform(0, 2 * one_push))
        process.send_signal(signal.SIGKILL)
        acknowledged = max([last, *pushed(process)])

        repository = hub.open(MODEL)
        last = loaded_version(repository, size)
        # Killed after the ref moved and before the answer: one more than acknowledged.
        assert acknowledged <= last <= acknowledged + 1
        assert verify(repository).problems == []
        with hub.lock(MODEL):
            garbage_collection.delete_history(repository)
    assert pushed(start(hub, "model.safetensors", last + 1, 1, size)) == [last + 1]
    assert loaded_version(hub.open(MODEL), size) == last + 1
    assert scan_cache_dir(hub.root).warnings == []


@pytest.fixture
def small_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    """Free at once what killed pushes left, so that the test needs little disk."""
    monkeypatch.setattr(garbage_collection, "ABANDONED", 0.0)
    monkeypatch.setattr("lerobot_act_chunking.hub.publishing.ABANDONED", 0.0)


@pytest.mark.usefixtures("small_folder")
def test_killed_pushes_leave_the_previous_revision(tmp_path: Path):
    assert_kills_are_harmless(LocalHub(tmp_path / "hub"), kills=2, size=4_000_000)


@full_tier
@pytest.mark.slow
@pytest.mark.usefixtures("small_folder")
@pytest.mark.timeout(900)
def test_twenty_killed_pushes_of_200_megabytes(tmp_path: Path):
    assert_kills_are_harmless(LocalHub(tmp_path / "hub"), kills=20, size=200_000_000)


def assert_every_push_lands(hub: LocalHub, pushers: int, pushes: int) -> None:
    processes = [start(hub, f"{k}.safetensors", 1000 * k, pushes, 100_000) for k in range(pushers)]
    for k, process in enumerate(processes):
        assert pushed(process) == list(range(1000 * k, 1000 * k + pushes))

    repository = hub.open(MODEL)
    head = repository.head("main")
    assert head is not None
    history = list(repository.history(head))
    # The first revision is the empty one that creating the repository makes.
    assert len(history) == len(repository.revisions()) == pushers * pushes + 1
    report = verify(repository)
    assert (report.problems, len(report.intact)) == ([], pushers * pushes + 1)
    # Each push built on the one before it: nothing that anybody pushed was lost on the way.
    for (_, newer), (_, older) in itertools.pairwise(history):
        assert set(older.files) <= set(newer.files)
        assert sum(newer.files[path] != older.files.get(path) for path in newer.files) == 1
    assert set(history[0][1].files) == {f"{k}.safetensors" for k in range(pushers)}
    assert scan_cache_dir(hub.root).warnings == []


def test_two_pushers_at_once_both_land(tmp_path: Path):
    assert_every_push_lands(LocalHub(tmp_path / "hub"), pushers=2, pushes=4)


@pytest.mark.slow
@full_tier
def test_four_pushers_of_twenty_five_pushes_each(tmp_path: Path):
    assert_every_push_lands(LocalHub(tmp_path / "hub"), pushers=4, pushes=25)
