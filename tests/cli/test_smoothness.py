"""``act-chunking smoothness`` from the terminal."""

import json
import re
from itertools import pairwise

import numpy as np
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_act_chunking.cli.main import main


def write_dataset(folder, episodes: int = 2) -> str:
    vector = {"dtype": "float32", "shape": (2,), "names": ["waist", "gripper"]}
    features = {"action": vector, "observation.state": vector}
    dataset = LeRobotDataset.create(f"me/{folder.name}", fps=50, features=features, root=folder)
    for episode in range(episodes):
        path = np.sin(0.02 * np.arange(61)[:, None] * [3.0 + episode, 5.0]).astype(np.float32)
        for state, action in pairwise(path):
            dataset.add_frame({"action": action, "observation.state": state, "task": "wave"})
        dataset.save_episode()
    dataset.finalize()
    return str(folder)


def test_two_datasets_side_by_side(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    paths = [write_dataset(tmp_path / "calm"), write_dataset(tmp_path / "lively", 3)]
    numbers, picture = tmp_path / "out" / "numbers.json", tmp_path / "pictures" / "all.png"
    outputs = ["--json", str(numbers), "--plot", str(picture)]
    assert main(["smoothness", *paths, "--replan-interval", "20", *outputs]) == 0
    out = capsys.readouterr().out
    for name in ("calm", "lively"):
        assert len(re.findall(rf"│ {name} ", out)) == 2  # one row in each table
    assert "numbers.json" in out
    assert picture.stat().st_size > 10_000
    document = json.loads(numbers.read_text(), parse_constant=pytest.fail)
    assert document["tool"] == "act-chunking smoothness"
    assert document["settings"]["replan_interval"] == 20
    assert [source["name"] for source in document["sources"]] == ["calm", "lively"]
    assert [source["episodes"] for source in document["sources"]] == [2, 3]
    assert document["sources"][0]["tracking_lag_s"] == dict.fromkeys(("arms", "grippers", "waist", "gripper"))
    assert "the state 1 step(s) later, to the bit: nobody commanded anything" in " ".join(out.split())
    assert document["sources"][0]["boundaries_per_episode"] == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["./nowhere"], "error: there is no checkpoint at ./nowhere"),
        (["."], "error: . holds neither a checkpoint (config.json"),
        (["./nowhere", "--episodes", "1"], "error: episodes=1: smoothness needs at least 2"),
        (["./nowhere", "--task", "juggle"], "error: unknown task 'juggle'; choose one of"),
        (["./nowhere", "--n-envs", "0"], "error: n_envs=0 must be at least 1"),
        (["./nowhere", "--replan-interval", "5"], "error: replan_interval=5 is for datasets"),
        ([], "Missing argument"),
    ],
)
def test_wrong_inputs_are_one_line(arguments, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["smoothness", *arguments]) == (1 if arguments else 2)
    assert message in capsys.readouterr().err


def test_one_episode_is_too_few(tmp_path, capsys):
    assert main(["smoothness", write_dataset(tmp_path / "single", episodes=1)]) == 1
    assert "error: smoothness needs at least 2 episodes, got 1" in capsys.readouterr().err
