"""``act-chunking data`` as a user meets it."""

import json

import numpy as np
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_act_chunking.cli.main import main

FEATURES = {
    "action": {"dtype": "float32", "shape": (2,), "names": ["reach", "gripper"]},
    "observation.state": {"dtype": "float32", "shape": (2,), "names": ["reach", "gripper"]},
    "observation.images.top": {
        "dtype": "image",
        "shape": (32, 32, 3),
        "names": ["height", "width", "channels"],
    },
    "operator": {"dtype": "int64", "shape": (1,), "names": None},
}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Three episodes; in the last one the camera is black."""
    folder = tmp_path_factory.mktemp("data") / "reaches"
    dataset = LeRobotDataset.create("me/reaches", fps=20, features=FEATURES, root=folder, use_videos=False)
    rng = np.random.default_rng(0)
    for episode in range(3):
        for step in range(60):
            row = np.array([np.sin(0.05 * step + episode), step // 20 % 2], np.float32)
            picture = rng.integers(0, 255, (32, 32, 3), dtype=np.uint8) * (episode < 2)
            dataset.add_frame(
                {
                    "action": row,
                    "observation.state": row,
                    "observation.images.top": picture.astype(np.uint8),
                    "operator": np.array([episode % 2]),
                    "task": "reach",
                }
            )
        dataset.save_episode()
    dataset.finalize()
    return str(folder)


def test_a_dataset_is_described(dataset, tmp_path, capsys):
    numbers, picture = tmp_path / "d.json", tmp_path / "d.png"
    assert main(["data", dataset, "--json", str(numbers), "--out", str(picture)]) == 11
    text = " ".join(capsys.readouterr().out.split())
    content = json.loads(numbers.read_text())
    assert content["cameras"][0]["episodes"][2]["blank"] == 1.0
    assert content["cameras"][0]["episodes"][0]["blank"] == 0.0
    assert content["operators"] == {"0": 2, "1": 1}
    assert "'observation.images.top' shows nothing (one grey, such as black) in the episodes 2" in text
    assert "--operation.episode_indices='[2]'" in text
    assert "--dataset.episodes='[0,2]'" in text
    assert picture.stat().st_size > 10_000


def test_cameras_can_be_left_alone(dataset, tmp_path):
    numbers = tmp_path / "d.json"
    assert main(["data", dataset, "--cameras", "none", "--json", str(numbers)]) == 0
    assert json.loads(numbers.read_text())["cameras"] == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "there is no dataset at nowhere: give a LeRobotDataset's folder"),
        (["--cameras", "few"], "unknown cameras 'few'; choose one of: none, sample, all"),
        (["--operator-column", "who"], "has no column 'who' (--operator-column)"),
    ],
)
def test_what_cannot_be_answered_is_said(dataset, arguments, message, capsys):
    where = [] if arguments[0] == "nowhere" else [dataset]
    assert main(["data", *where, *arguments]) == 1
    assert message in " ".join(capsys.readouterr().err.split())
