"""The whole quickstart, tiny, in processes that cannot open a connection."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from tiers import full_tier

NO_NETWORK = """
import socket

def refuse(*args, **kwargs):
    raise OSError(f"airplane mode: connection to {args[-1]!r} refused by the test")

def connect(self, address):
    if self.family == socket.AF_UNIX:
        return unix_connect(self, address)
    refuse(address)

unix_connect = socket.socket.connect
socket.socket.connect = connect
socket.socket.connect_ex = connect
socket.getaddrinfo = refuse
"""


@pytest.fixture
def airplane(tmp_path) -> dict[str, str]:
    """Variables under which every Python process refuses to connect anywhere and finds no cached files."""
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(NO_NETWORK)
    offline = {"PYTHONPATH": str(tmp_path / "site"), "HF_HOME": str(tmp_path / "hf"), "HOME": str(tmp_path)}
    return {**os.environ, **offline, "COLUMNS": "200"}


def test_the_block_blocks(airplane):
    code = "import socket; socket.create_connection(('192.0.2.1', 80), timeout=1)"
    done = subprocess.run(
        [sys.executable, "-c", code], env=airplane, capture_output=True, text=True, check=False
    )
    assert "airplane mode" in done.stderr


@full_tier
@pytest.mark.timeout(1800)
def test_quickstart_runs_offline_quietly_and_goes_on_where_it_was(tmp_path, airplane):
    command = [
        *(str(Path(sys.executable).parent / "act-chunking"), "quickstart"),
        *("--output-dir", "out", "--episodes", "2", "--steps", "4", "--eval-episodes", "2"),
    ]
    done = subprocess.run(command, cwd=tmp_path, env=airplane, capture_output=True, text=True, check=False)
    output = done.stdout + done.stderr
    assert done.returncode == 0, output[-4000:]
    for line in (
        "$ act-chunking record",
        "$ lerobot-train",
        "$ lerobot-eval",
        "$ act-chunking motion",
        "success:",
    ):
        assert line in output
    for noise in ("Traceback", "libtorchcodec", "FFmpeg", "Warning:"):
        assert noise not in output, output[output.index(noise) - 500 : output.index(noise) + 500]

    out = tmp_path / "out"
    evaluation = json.loads((out / "eval" / "eval_info.json").read_text())
    assert evaluation["overall"]["n_episodes"] == 2
    assert (out / "motion.png").stat().st_size > 20_000
    assert len(list((out / "eval").rglob("*.mp4"))) == 2

    before = (out / "eval" / "eval_info.json").stat().st_mtime_ns
    again = subprocess.run(command, cwd=tmp_path, env=airplane, capture_output=True, text=True, check=True)
    assert again.stdout.count("already done") == 4
    assert (out / "eval" / "eval_info.json").stat().st_mtime_ns == before
