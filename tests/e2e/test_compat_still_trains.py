"""A LeRobot and a huggingface_hub that the package does not fit: it steps aside, and training goes on."""

import os
import subprocess
import sys

import numpy as np
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from policy_cases import MODULES, TYPES
from tiers import full_tier

pytestmark = full_tier

STRANGERS = """
import sys
from huggingface_hub import constants
from lerobot.datasets.dataset_reader import DatasetReader
del constants.HF_HUB_DISABLE_XET  # requests cannot be routed
get_item = DatasetReader.get_item
DatasetReader.get_item = lambda self, idx: get_item(self, idx)  # other insides, the same items
from lerobot.scripts.lerobot_train import main
main()
"""


@pytest.fixture
def dataset(tmp_path):
    features = {
        key: {"dtype": "float32", "shape": (n,), "names": None}
        for key, n in {"observation.state": 6, "action": 4}.items()
    }
    root = tmp_path / "dataset"
    recording = LeRobotDataset.create("test/toy", fps=50, features=features, root=root, use_videos=False)
    for frame in np.random.default_rng(0).normal(size=(12, 10)).astype(np.float32):
        recording.add_frame({"observation.state": frame[:6], "action": frame[6:], "task": "toy"})
    recording.save_episode()
    recording.finalize()
    return root


def test_it_says_so_once_and_trains(dataset, tmp_path):
    policy = f"--policy.type={TYPES[0]} {MODULES[TYPES[0]].TRAINED}"
    run = f"--dataset.repo_id=test/toy --dataset.root={dataset} --output_dir={tmp_path / 'run'} --steps=2"
    quiet = "--policy.device=cpu --policy.push_to_hub=false --num_workers=0 --batch_size=3"
    done = subprocess.run(
        [sys.executable, "-c", STRANGERS, *f"{policy} {run} {quiet}".split()],
        env={**os.environ, "LEROBOT_LOCAL_HUB": str(tmp_path / "hub"), "HF_HUB_OFFLINE": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    for line in ("fast chunks are off and LeRobot's own reader is used", "the local hub is off"):
        assert done.stderr.count(line) == 1, done.stderr
    assert (tmp_path / "run" / "checkpoints" / "000002" / "pretrained_model" / "model.safetensors").is_file()
