"""A stranger's instrument is one short file: the command, JSON and exit statuses come from the kernel."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import typer
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_act_chunking.cli.running import run

EXAMPLES = Path(__file__).parents[3] / "examples"
FPS, WAIT = 10, 12


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Two episodes that move at every step, but for a wait in the second."""
    folder = tmp_path_factory.mktemp("data") / "waits"
    features = {"action": {"dtype": "float32", "shape": (2,), "names": ["x", "y"]}}
    dataset = LeRobotDataset.create("me/waits", fps=FPS, features=features, root=folder)
    for waiting in (0, WAIT):
        for step in [*range(20), *[19] * waiting, *range(20, 30)]:
            dataset.add_frame({"action": np.array([step, 0], np.float32), "task": "wait"})
        dataset.save_episode()
    dataset.finalize()
    return str(folder)


@pytest.fixture
def command(monkeypatch):
    """Runs the instrument with these arguments; returns its exit status."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    import own_instrument

    app = typer.Typer()
    app.command()(own_instrument.waiting_command)
    yield lambda *arguments: run(app, [*arguments], "waiting")
    del sys.modules["own_instrument"]


def test_it_measures_prints_and_writes(command, dataset, tmp_path, capsys):
    assert command(dataset, "--json", str(tmp_path / "w.json")) == 0
    content = json.loads((tmp_path / "w.json").read_text())
    assert list(content) == ["tool", "version", "verdict", "reasons", "longest_s"]
    assert (content["tool"], content["verdict"]) == ("waiting", "warn")
    assert content["longest_s"] == pytest.approx(WAIT / FPS)
    assert "warn: the longest wait takes 1.2 s, allowed 1 s" in capsys.readouterr().out
    assert command(dataset, "--most-s", "1.2") == 0
    assert "pass: " in capsys.readouterr().out


def test_it_refuses_as_all_do(command, dataset, capsys):
    assert command(dataset, "--most-s", "0") == 1
    assert "error: most_s=0.0 must be a positive number" in capsys.readouterr().err
    assert command(dataset, "--speed", "1") == 2
    assert command("nowhere") == 1


def test_it_is_short():
    assert len((EXAMPLES / "own_instrument.py").read_text().splitlines()) <= 60
