"""``act-chunking resolution`` as a user meets it."""

import json

import numpy as np
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_act_chunking.cli.main import main

FEATURES = {
    "action": {"dtype": "float32", "shape": (2,), "names": ["reach", "gripper"]},
    "observation.state": {"dtype": "float32", "shape": (3,), "names": None},
}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data") / "waves"
    dataset = LeRobotDataset.create("me/waves", fps=20, features=FEATURES, root=folder)
    for episode in range(3):
        for step in range(120):
            action = np.array([np.sin(0.05 * step + episode), step // 30 % 2])
            dataset.add_frame(
                {
                    "action": action.astype(np.float32),
                    "observation.state": np.zeros(3, np.float32),
                    "task": "wave",
                }
            )
        dataset.save_episode()
    dataset.finalize()
    return str(folder)


def test_a_dataset_gets_a_stride(dataset, tmp_path, capsys):
    numbers, picture = tmp_path / "r.json", tmp_path / "r.png"
    arguments = ["--gripper-dims", "1", "--horizon-s", "1.5", "--json", str(numbers), "--out", str(picture)]
    assert main(["resolution", dataset, *arguments]) == 0
    text = capsys.readouterr().out
    content = json.loads(numbers.read_text())
    stride, size = content["recommended"].values()
    assert stride > 1
    assert f"recommended: --policy.chunk_stride={stride} --policy.chunk_size={size}" in text
    assert (size - 1) * stride + 1 >= 30 > (size - 2) * stride + 1
    assert "pass: " in text
    assert picture.stat().st_size > 10_000


def test_a_stride_that_is_too_coarse_fails(dataset, capsys):
    assert main(["resolution", dataset, "--gripper-dims", "1", "--chunk-stride", "20"]) == 11
    assert "fail: chunk_stride=20 is too coarse" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "there is no LeRobotDataset at nowhere: give its folder"),
        (["--strides", "2;5"], "strides='2;5' must be numbers with commas between them"),
        (["--gripper-dims", "2"], "2 is no dimension of these actions, which have 2"),
        (["--horizon-s", "7"], "no episode of"),
        (["--tolerance", "0"], "tolerance=0.0 must be a positive number"),
    ],
)
def test_what_cannot_be_answered_is_said(dataset, arguments, message, capsys):
    where = [] if arguments[0] == "nowhere" else [dataset]
    assert main(["resolution", *where, *arguments]) == 1
    assert message in " ".join(capsys.readouterr().err.split())
