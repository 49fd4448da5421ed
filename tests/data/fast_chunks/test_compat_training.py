"""What LeRobot 0.7 brings to training, and LeRobots that fast chunks do not fit."""

import sys
from dataclasses import make_dataclass
from types import SimpleNamespace

import datasets
import pytest
from lerobot.configs import train
from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.datasets import factory
from lerobot.datasets.dataset_reader import DatasetReader
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot_sets import REPO_ID
from policy_cases import any_config

from lerobot_act_chunking import compat
from lerobot_act_chunking.data import fast_chunks
from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset
from lerobot_act_chunking.errors import ConfigurationError

pytestmark = pytest.mark.usefixtures("stock_factory")


def config(root, **policy) -> TrainPipelineConfig:
    source = DatasetConfig(REPO_ID, root=str(root), video_backend="pyav")
    return TrainPipelineConfig(source, policy=any_config(**policy))


@pytest.mark.parametrize(
    ("theirs", "ours", "refused"),
    [(True, True, True), (True, False, False), (False, True, False), (None, True, False)],
)
def test_only_one_average_of_the_weights(states, theirs, ours, refused):
    cfg = config(states, use_ema=ours)
    vars(cfg)["ema"] = None if theirs is None else SimpleNamespace(enable=theirs)
    fast_chunks.install()
    if refused:
        with pytest.raises(ConfigurationError, match=r"--ema.enable=false.*--policy.use_ema=false"):
            factory.make_dataset(cfg)
    else:
        assert isinstance(factory.make_dataset(cfg), FastChunkDataset)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["wandb", "steps"], ["--wandb.enable=false"]),
        (["steps", "trackio"], ["--trackio.enable=false"]),
        (["wandb", "trackio"], ["--wandb.enable=false", "--trackio.enable=false"]),
        (["steps"], []),
    ],
)
def test_trackers_are_switched_off_by_the_options_that_there_are(monkeypatch, names, expected):
    monkeypatch.setattr(train, "TrainPipelineConfig", make_dataclass("TrainPipelineConfig", names))
    assert compat.trackers_off() == expected


def test_the_installed_lerobot_has_a_tracker_to_switch_off():
    assert compat.trackers_off()


MISSING = {
    "a module": lambda patch: patch.setitem(sys.modules, "lerobot.datasets.dataset_reader", None),
    "the factory's name": lambda patch: patch.delattr(factory, "LeRobotDataset"),
    "the factory's function": lambda patch: patch.delattr(factory, "make_dataset"),
    "a method": lambda patch: patch.delattr(DatasetReader, "get_item"),
    "an attribute": lambda patch: patch.setattr(DatasetReader, "__init__", lambda self, **_: None),
    "a type of datasets": lambda patch: patch.delattr(datasets, "List"),
    "another table": lambda patch: patch.setattr(datasets.Dataset, "__init__", lambda self: None),
    "a compiled reader": lambda patch: patch.setattr(DatasetReader, "get_item", len),
    "batches of its own": lambda patch: patch.setattr(LeRobotDataset, "__getitems__", len, raising=False),
}


@pytest.mark.parametrize("missing", MISSING)
def test_a_lerobot_that_does_not_fit_is_left_alone_with_one_line(monkeypatch, caplog, missing):
    MISSING[missing](monkeypatch)
    before = dict(vars(factory))
    assert not fast_chunks.install()
    assert dict(vars(factory)) == before
    (line,) = caplog.messages
    assert line.startswith("fast chunks are off and LeRobot's own reader is used: ")
