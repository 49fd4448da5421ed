"""A policy of each type acts on the simulated arm in each way, with whatever goes wrong."""

import json
import subprocess
import sys

import pytest
from page_commands import ROOT, Terminal
from policy_cases import TYPES
from tiers import full_tier

RECORD = (
    "act-chunking record --env so_arm_sim --obs pixels_state --image-height 48 --image-width 64 "
    "--render-quality fast --episodes 2 --repo-id local/data --root data"
)
ROBOT = "--robot.type=so_arm_sim --robot.cameras='{%s: {width: 64, height: 48}%s}'"
POLICY = "--policy.device=cpu --policy.push_to_hub=false --policy.pretrained_backbone_weights=null"
POLICY += " --policy.vision_backbone=small_cnn"


@pytest.fixture(scope="module")
def terminal(tmp_path_factory):
    """Where two demonstrations were recorded."""
    terminal = Terminal(tmp_path_factory.mktemp("arm"))
    terminal.run(RECORD)
    return terminal


@pytest.fixture(scope="module")
def checkpoint(terminal):
    """Train a policy of some type for a moment; its folder."""

    def train(kind, steps=2):
        tokenizer = "--policy.n_vqvae_training_steps=1 " if kind == "vqbet_chunked" else ""
        terminal.run(
            f"lerobot-train --policy.type={kind} {POLICY} {tokenizer}--dataset.repo_id=local/data "
            f"--dataset.root=data --batch_size=4 --num_workers=0 --steps={steps} --output_dir={kind}_{steps}"
        )
        return terminal.folder / f"{kind}_{steps}" / "checkpoints" / "last" / "pretrained_model"

    return train


def acted(folder, checkpoint, *asked):
    """The cells of ``benchmarks/so_arm_faults.py``, by way of acting and by fault."""
    out = folder / "cells.json"
    script = ROOT / "benchmarks" / "so_arm_faults.py"
    command = [sys.executable, str(script), str(checkpoint), "--out", str(out), *asked]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    return {(each["mode"], each["fault"]): each for each in json.loads(out.read_text())}


@full_tier
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("kind", TYPES)
def test_every_type_acts_in_every_way(terminal, checkpoint, tmp_path, kind):
    """What LeRobot's rtc and its policy server refused, and what stood still."""
    folder = checkpoint(kind)
    cells = acted(tmp_path, folder, "--faults", "none", "--seconds", "4")
    assert {mode for mode, _ in cells} == {"sync", "background", "rtc", "served"}
    for (mode, _), cell in cells.items():
        assert cell["exit"] == (1 if mode == "served" else 0), cell  # the client is stopped
        assert cell["actions"] > 30, cell

    refused = terminal.run(f"act-chunking check {folder} {ROBOT % ('front', '')}")
    assert "there is no observation.images.wrist" in refused
    both = ROBOT % ("front", ", wrist: {width: 64, height: 48}")
    slow = terminal.run(f"lerobot-rollout --policy.path={folder} {both} --fps=5 --duration=1 --device=cpu")
    assert "6 times as slowly as demonstrated; set --fps=30" in slow


@full_tier
@pytest.mark.timeout(2400)
def test_no_fault_makes_the_arm_jump_or_the_command_fall_over(checkpoint, tmp_path):
    cells = acted(tmp_path, checkpoint(TYPES[0], steps=40), "--seconds", "6")
    assert len(cells) == 30
    for (mode, fault), cell in cells.items():
        told = " ".join(cell["said"])
        gone = fault == "unplugged camera"
        assert cell["exit"] == (1 if mode == "served" or gone else 0), cell
        assert cell["jump"] <= 1.5, cell
        if gone:
            assert "the latest picture of the camera wrist is too old" in told, cell
        if fault == "frozen camera":
            assert "observation.images.wrist shows the same picture" in told, cell
        if fault == "server killed, started again":
            assert cell["longest_hold_s"] > 2, cell
