"""``act-chunking replay`` as a user meets it."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.utils.feature_utils import dataset_to_policy_features
from small_policies import CHUNK, OURS, make_policy, save
from tiers import full_tier

from lerobot_act_chunking.cli.main import main

REFUSED, FAILED = 1, 11
RECORDINGS = Path(os.environ.get("ACT_CHUNKING_RECORDINGS", "../shared/data"))
STATE = {"observation.state": PolicyFeature(FeatureType.STATE, (2,))}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("replayed") / "waves"
    vector = {"dtype": "float32", "shape": (2,), "names": ["reach", "gripper"]}
    features = {"action": vector, "observation.state": vector}
    dataset = LeRobotDataset.create("me/waves", fps=20, features=features, root=folder)
    for length in (22, 30, 27):
        for step in range(length):
            at = np.sin(0.3 * step + np.arange(2)).astype(np.float32)
            dataset.add_frame({"action": at, "observation.state": at, "task": "wave"})
        dataset.save_episode()
    dataset.finalize()
    return str(folder)


@pytest.fixture(scope="module")
def checkpoint(dataset, tmp_path_factory):
    """One whose training used the first two episodes."""
    folder = tmp_path_factory.mktemp("policy")
    save(make_policy(inputs=STATE, start=torch.zeros(2)), folder)
    training = {"dataset": {"repo_id": "me/waves", "root": dataset, "episodes": [0, 1]}}
    (folder / "train_config.json").write_text(json.dumps(training))
    return str(folder)


def test_an_untrained_policy_fails_on_the_episode_that_it_has_not_seen(checkpoint, dataset, tmp_path, capsys):
    numbers, picture = tmp_path / "replay.json", tmp_path / "replay.png"
    asked = ["replay", checkpoint, dataset, "--observations", "40"]
    status = main([*asked, "--episodes", "0,2", "--json", str(numbers), "--out", str(picture)])
    assert status == FAILED
    out = " ".join(capsys.readouterr().out.split())
    assert "2 episodes, 1 of which it has learned from" in out
    assert "the policy has learned from replayed episodes" in out
    content = json.loads(numbers.read_text(), parse_constant=pytest.fail)
    assert (content["tool"], content["episodes"], content["learned"]) == ("replay", [0, 2], [0])
    assert [each["name"] for each in content["dimensions"]] == ["reach", "gripper"]
    assert [each["name"] for each in content["grippers"]] == ["gripper"]
    assert len(content["dimensions"][0]["median"]["nearest"]) == 8
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert main([*asked, "--json", str(numbers)]) != REFUSED
    assert json.loads(numbers.read_text())["episodes"] == [2]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--episodes", "7"], "has no such episodes, but 3, from 0 to 2"),
        (["--episodes", "x"], "must be numbers with commas between them: 40,41,42"),
        (["--observations", "0"], "observations=0 must be at least 1"),
    ],
)
def test_wrong_questions_are_refused_in_one_line(arguments, message, checkpoint, dataset, capsys):
    assert main(["replay", checkpoint, dataset, *arguments]) == REFUSED
    assert message in " ".join(capsys.readouterr().err.split())


def test_no_dataset(checkpoint, capsys):
    assert main(["replay", checkpoint, "./nowhere"]) == REFUSED
    assert "there is no dataset at" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "type_"),
    [
        ("so101_real", OURS),
        *(
            pytest.param(*each, marks=full_tier)
            for each in (
                ("piper55", OURS),
                ("open50r", OURS),
                ("cloth", "act"),
                ("g1", "act"),
                ("g1", OURS),
            )
        ),
    ],
)
def test_real_recordings_of_states_and_cameras(name, type_, tmp_path):
    folder = RECORDINGS / name
    if not folder.is_dir():
        pytest.skip(f"there is no {folder}")
    meta = LeRobotDatasetMetadata(f"local/{name}", root=folder)
    features = dataset_to_policy_features(meta.features)
    inputs = {key: each for key, each in features.items() if key.startswith("observation")}
    start = torch.as_tensor(np.ravel(meta.stats["action"]["mean"]), dtype=torch.float32)
    own = {"pretrained_backbone_weights": None, "n_action_steps": CHUNK} if type_ == "act" else {}
    policy = save(make_policy(type_, inputs, start, **own), tmp_path / "policy")
    numbers = tmp_path / "replay.json"
    asked = ["replay", policy, str(folder), "--episodes", "0", "--observations", "40"]
    assert main([*asked, "--json", str(numbers), "--out", str(tmp_path / "replay.png")]) == FAILED
    content = json.loads(numbers.read_text(), parse_constant=pytest.fail)
    assert content["learned"] == []
    assert content["following"]["variation"] < 1
