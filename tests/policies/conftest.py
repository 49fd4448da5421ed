"""LeRobot's training command over a small dataset."""

import sys

import pytest
from training_runs import record


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return record(tmp_path_factory.mktemp("toy") / "dataset")


@pytest.fixture
def train(monkeypatch):
    from lerobot.scripts import lerobot_train

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["lerobot-train", *arguments])
        lerobot_train.main()

    return run
