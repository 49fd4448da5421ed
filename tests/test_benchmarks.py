"""Asking a benchmark what it does must not run it."""

import json
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from gymnasium.envs import registration
from lerobot.envs.configs import EnvConfig
from lerobot.utils.import_utils import register_third_party_plugins
from tiers import full_tier

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
FILES = sorted(BENCHMARKS.glob("*.py"))
SCRIPTS = [file for file in FILES if "__main__" in file.read_text()]


@pytest.fixture
def run(monkeypatch, tmp_path):
    """Runs a file as `python <file> --help` would, in an empty folder, without a process of its own."""

    def run(file: Path) -> None:
        monkeypatch.setattr(sys, "argv", [str(file), "--help"])
        runpy.run_path(str(file), run_name="__main__")

    register_third_party_plugins()  # stays; what a file registers is forgotten with it
    monkeypatch.setattr(EnvConfig, "_choice_registry", dict(EnvConfig._choice_registry))
    monkeypatch.setattr(registration, "registry", dict(registration.registry))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    before = set(sys.modules)
    yield run
    for name in set(sys.modules) - before:  # "policy", "execution", ...: plain names, which others may want
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(BENCHMARKS)):
            del sys.modules[name]


# Loaded twice, as a script and for another one.
@pytest.mark.filterwarnings("ignore:.*Overriding environment vqbet_pixels:UserWarning")
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda file: file.stem)
def test_every_script_answers_help_and_does_nothing_else(script, run, capsys, tmp_path):
    with pytest.raises(SystemExit) as end:
        run(script)
    assert end.value.code == 0
    assert f"usage: {script.name}" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "module", [file for file in FILES if file not in SCRIPTS], ids=lambda file: file.stem
)
def test_what_is_no_script_does_nothing(module, run, capsys, tmp_path):
    run(module)
    assert capsys.readouterr().out == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ([], "PyTorch sees none here; --device cpu --tiny rehearses it"),
        (["--device=cpu", "--tiny"], "--out with a file of your own"),
    ],
    ids=["no GPU", "a rehearsal in place of the results"],
)
def test_a_gpu_is_not_measured_without_one(monkeypatch, options, told):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(sys, "argv", ["gpu.py", *options])
    with pytest.raises(SystemExit, match=told):
        runpy.run_path(str(BENCHMARKS / "gpu.py"), run_name="__main__")


@full_tier
def test_the_measurement_of_a_gpu_can_be_rehearsed(tmp_path):
    rehearsal = ["--device=cpu", "--tiny", f"--out={tmp_path / 'found.json'}"]
    command = [sys.executable, "-W", "ignore", str(BENCHMARKS / "gpu.py"), *rehearsal]
    subprocess.run(command, check=True, capture_output=True)
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["rehearsal"]
    ways = {(each["policy"], each["precision"], each["compiled"]) for each in found["measured"]}
    assert len(ways) == len(found["measured"]) == 6 * 4
    weights = {each["policy"]: each["weights"] for each in found["measured"]}
    for theirs in ("act", "diffusion", "vqbet"):
        assert weights[f"{theirs}_chunked"] == pytest.approx(weights[theirs], rel=0.1)
    assert all(each["samples_per_s"] > 0 and each["chunk_ms"] > 0 for each in found["measured"])
