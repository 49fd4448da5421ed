"""The examples, one after the other, at tiny size, as a reader would run them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tiers import full_tier

EXAMPLES = Path(__file__).parents[2] / "examples"


def run(name: str, *args: str) -> str:
    command = [sys.executable, "-W", "ignore", str(EXAMPLES / name), *args]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, "COLUMNS": "200"}
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    return done.stdout


@full_tier
@pytest.mark.timeout(1800)
def test_the_examples_build_on_each_other(tmp_path):
    data, out = tmp_path / "dataset", tmp_path / "train"
    recorded = run("01_record.py", "--root", str(data), "--episodes", "2")
    assert "recorded 2 episodes" in recorded
    assert "observation.environment_state: (7,) torch.float32" in recorded

    run("02_train.py", "--root", str(data), "--out", str(out), "--steps", "2")
    policy = str(out / "checkpoints" / "last" / "pretrained_model")
    assert (Path(policy) / "model.safetensors").exists()

    evaluated = run("03_evaluate.py", "--policy", policy, "--episodes", "2")
    assert "lifted and held by the left arm alone: " in evaluated
    assert "/2 episodes, 95 % Wilson interval" in evaluated

    assert " after 30 steps" in run("04_policy_in_your_loop.py", "--policy", policy, "--steps", "30")

    executed = run("05_execute_chunks.py", "--policy", policy, "--episodes", "2")
    assert executed.count("/2 episodes, 95 % Wilson interval") == 4
    assert "network calls per episode 16.0" in executed

    codes = run("06_actions_as_codes.py", "--root", str(data), "--steps", "20")
    assert "dct: 70 codes, 422 bits, error 0." in codes
    assert codes.count(" of half the range") == 4


def test_every_example_is_run_and_short():
    scripts = sorted(EXAMPLES.glob("0*.py"))  # own_environment.py has tests of its own
    text = Path(__file__).read_text()
    assert scripts
    for script in scripts:
        assert f'"{script.name}"' in text
        assert len(script.read_text().splitlines()) < 80
