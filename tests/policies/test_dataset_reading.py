"""Only what a policy reads and predicts is checked, normalised and decoded."""

from pathlib import Path
from typing import Any

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.datasets import factory
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.factory import make_policy, make_pre_post_processors
from lerobot.utils.import_utils import register_third_party_plugins
from policy_cases import SIZES, TYPES
from recorded_sets import ENV, FORCE, KINDS, SIDE, STATE, TOP, images, record
from torch.utils.data import default_collate

from lerobot_act_chunking.data.fast_chunks import install
from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset
from lerobot_act_chunking.errors import DatasetError


@pytest.fixture(autouse=True)
def plugged():
    register_third_party_plugins()
    assert install()


def configuration(policy_type: str, **settings: Any) -> Any:
    config_class = PreTrainedConfig.get_choice_class(policy_type)
    return config_class(**SIZES[policy_type] | settings, device="cpu", push_to_hub=False)


def train(root: Path, policy_type: str, **settings: Any) -> dict[str, Any]:
    """One step as lerobot-train makes it; returns the batch that the policy got."""
    config = configuration(policy_type, **settings)
    source = DatasetConfig("tests/read", root=str(root), use_imagenet_stats=False)
    dataset = factory.make_dataset(TrainPipelineConfig(source, policy=config, num_workers=0))
    assert isinstance(dataset, FastChunkDataset)
    policy = make_policy(config, ds_meta=dataset.meta)
    preprocessor, _ = make_pre_post_processors(config, dataset_stats=dataset.meta.stats)
    batch = preprocessor(default_collate(dataset.__getitems__([0, 5, 20])))
    loss, _ = policy.train().forward(batch)
    assert torch.isfinite(loss)
    assert policy.config.output_features.keys() == {"action"}
    return batch


# LeRobot's statistics of values that are not finite.
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", KINDS)
def test_columns_that_are_not_read_may_hold_anything(tmp_path, name):
    root = record(tmp_path / "set", {FORCE: KINDS[name], "action.note": KINDS[name]})
    for policy_type in TYPES:
        for left_out in ({"state_keys": [STATE]}, {"input_features": {STATE: _state()}}):
            assert torch.isfinite(train(root, policy_type, **left_out)[STATE]).all()


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("key", [FORCE, ENV])
def test_what_is_read_and_unusable_is_named_and_the_way_out_works(tmp_path, key, name):
    root = record(tmp_path / "set", {key: KINDS[name]})
    for policy_type in TYPES:
        with pytest.raises(DatasetError, match=f"{key}") as error:
            train(root, policy_type)
        setting = {
            FORCE: "--policy.state_keys='[observation.state]'",
            ENV: "--policy.input_features='{observation.state: {type: STATE, shape: [6]}}'",
        }[key]
        assert setting in str(error.value)
    train(
        root, policy_type, **{FORCE: {"state_keys": [STATE]}, ENV: {"input_features": {STATE: _state()}}}[key]
    )


def _state() -> PolicyFeature:
    return PolicyFeature(FeatureType.STATE, (6,))


def test_unusable_actions_can_only_be_recorded_again(tmp_path):
    root = record(tmp_path / "set", {})
    config = configuration(TYPES[0])
    features = LeRobotDataset("tests/read", root).meta.features
    features = {**features, "action": {**features["action"], "dtype": "int64"}}
    with pytest.raises(DatasetError, match=r"'action' holds int64\. Record it as float32"):
        config.check_dataset(features, LeRobotDataset("tests/read", root).meta)


def test_cameras_that_are_not_read_are_not_decoded(tmp_path):
    root = record(tmp_path / "set", images((TOP, SIDE)))
    top = PolicyFeature(FeatureType.VISUAL, (3, 32, 40))
    batch = train(root, TYPES[0], input_features={STATE: _state(), TOP: top})
    assert TOP in batch
    assert SIDE not in batch
