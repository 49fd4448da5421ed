import logging
import subprocess
import sys

import pytest
from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.datasets import factory
from lerobot.datasets.dataset_reader import DatasetReader
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot_sets import REPO_ID, assert_same, batch
from tiers import full_tier

from lerobot_act_chunking.data import fast_chunks
from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset

pytestmark = pytest.mark.usefixtures("stock_factory")


def config(root, **dataset) -> TrainPipelineConfig:
    source = DatasetConfig(REPO_ID, root=str(root), video_backend="pyav", **dataset)
    return TrainPipelineConfig(source, policy=ACTConfig(chunk_size=3, n_action_steps=3, device="cpu"))


def test_install_and_uninstall(states):
    original = (factory.LeRobotDataset, factory.make_dataset)
    assert fast_chunks.install()
    assert isinstance(factory.make_dataset(config(states)), FastChunkDataset)
    fast_chunks.uninstall()
    assert (factory.LeRobotDataset, factory.make_dataset) == original
    assert type(factory.make_dataset(config(states))) is LeRobotDataset


def test_nothing_else_of_lerobot_is_replaced():
    before = {cls: dict(vars(cls)) for cls in (LeRobotDataset, DatasetReader)}
    names = dict(vars(factory))
    fast_chunks.install()
    assert {cls: dict(vars(cls)) for cls in before} == before
    changed = {name for name, value in vars(factory).items() if names.get(name) is not value}
    assert changed == {"LeRobotDataset", "make_dataset", "resolve_delta_timestamps"}


def test_installing_and_uninstalling_twice_is_installing_and_uninstalling_once():
    original = factory.make_dataset
    fast_chunks.install()
    once = (factory.LeRobotDataset, factory.make_dataset)
    assert fast_chunks.install()
    assert (factory.LeRobotDataset, factory.make_dataset) == once
    fast_chunks.uninstall()
    fast_chunks.uninstall()
    assert factory.make_dataset is original


def test_the_environment_switches_it_off(monkeypatch):
    monkeypatch.setenv("ACT_CHUNKING_FAST_CHUNKS", "0")
    assert not fast_chunks.install()
    assert factory.LeRobotDataset is LeRobotDataset


def test_train_and_held_out_episodes_are_both_fast(states):
    fast_chunks.install()
    ours = factory.make_train_eval_datasets(config(states, eval_split=0.5))
    fast_chunks.uninstall()
    theirs = factory.make_train_eval_datasets(config(states, eval_split=0.5))
    for fast, stock in zip(ours, theirs, strict=True):
        assert isinstance(fast, FastChunkDataset)
        assert fast.episodes == stock.episodes
        assert_same(batch(fast, range(len(fast))), [stock[row] for row in range(len(stock))])


def assert_left_alone(caplog, reason: str) -> None:
    kept = factory.LeRobotDataset
    with caplog.at_level(logging.WARNING):
        assert not fast_chunks.install()
    assert factory.LeRobotDataset is kept
    assert caplog.messages == [f"fast chunks are off and LeRobot's own reader is used: {reason}"]


def test_a_lerobot_that_gathers_batches_itself_is_left_alone(monkeypatch, caplog):
    monkeypatch.setattr(LeRobotDataset, "__getitems__", lambda *_: [], raising=False)
    assert_left_alone(caplog, "LeRobotDataset has a __getitems__ of its own")


def test_a_reader_with_other_insides_is_left_alone(monkeypatch, caplog):
    def get_item(self, idx):
        return self.table[idx]

    get_item.__qualname__ = "DatasetReader.get_item"
    monkeypatch.setattr(DatasetReader, "get_item", get_item)
    assert_left_alone(caplog, "DatasetReader.get_item has no hf_dataset")


def test_a_lerobot_without_a_reader_is_left_alone(monkeypatch, caplog):
    monkeypatch.setitem(sys.modules, "lerobot.datasets.dataset_reader", None)
    assert_left_alone(caplog, "import of lerobot.datasets.dataset_reader halted; None in sys.modules")


def test_a_factory_that_somebody_else_replaced_is_left_alone(monkeypatch, caplog):
    class OtherDataset(LeRobotDataset):
        pass

    monkeypatch.setattr(factory, "LeRobotDataset", OtherDataset)
    assert_left_alone(caplog, f"LeRobot's dataset factory already builds {OtherDataset.__qualname__}")


@full_tier
def test_discovery_installs_it():
    code = (
        "from lerobot.utils.import_utils import register_third_party_plugins as discover; discover();"
        "from lerobot.datasets import factory; print(factory.LeRobotDataset.__name__)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.split()[-1] == "FastChunkDataset"
