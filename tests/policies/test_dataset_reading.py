"""Only what a policy reads and predicts is checked, normalised and decoded."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.datasets import factory
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.factory import make_policy, make_pre_post_processors
from lerobot.utils.import_utils import register_third_party_plugins
from torch.utils.data import default_collate

from lerobot_act_chunking.data.fast_chunks import install
from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset
from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig
from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)
from lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked import VqbetChunkedConfig

STATE, FORCE, ENV = "observation.state", "observation.force", "observation.environment_state"
TOP, SIDE = "observation.images.top", "observation.images.side"
SMALL: dict[type, dict[str, Any]] = {
    ActChunkedConfig: {"chunk_size": 5, "dim_model": 32, "n_heads": 4, "dim_feedforward": 24},
    DiffusionChunkedConfig: {"horizon": 8, "dim_model": 32, "n_layers": 1, "actions_per_token": 1},
    VqbetChunkedConfig: {"chunk_size": 5, "gpt_hidden_dim": 32, "gpt_n_layer": 1, "gpt_n_head": 2}
    | {"n_vqvae_training_steps": 2, "vqvae_n_embed": 4},
}
KINDS = {
    "text": ({"dtype": "string", "shape": (1,), "names": None}, lambda _: "reach"),
    "bool": ({"dtype": "bool", "shape": (2,), "names": None}, lambda step: np.array([step % 2 == 0, True])),
    "int": ({"dtype": "int64", "shape": (3,), "names": None}, lambda step: np.array([step, 1, 2])),
    "NaN": (
        {"dtype": "float32", "shape": (2,), "names": None},
        lambda step: np.array([step, np.nan if step == 7 else 1], np.float32),
    ),
}


@pytest.fixture(autouse=True)
def plugged():
    register_third_party_plugins()
    assert install()


def vector(size):
    return {"dtype": "float32", "shape": (size,), "names": None}


def record(root: Path, extra: dict[str, tuple[dict, Any]]) -> Path:
    """Two episodes of waves, with columns besides: their feature, and their value at a step."""
    features = {
        "action": vector(4),
        STATE: vector(6),
        **{key: feature for key, (feature, _) in extra.items()},
    }
    dataset = LeRobotDataset.create("tests/read", 10, features, root=root, use_videos=False)
    for length in (12, 9):
        for step in range(length):
            wave = {key: np.sin(np.arange(size) + step / 5) for key, size in (("action", 4), (STATE, 6))}
            numbers = {key: value.astype(np.float32) for key, value in wave.items()}
            more = {key: value(step) for key, (_, value) in extra.items()}
            dataset.add_frame({**numbers, **more, "task": "do"})
        dataset.save_episode()
    dataset.finalize()
    return root


def train(root: Path, kind: type, **settings: Any) -> dict[str, Any]:
    """One step as lerobot-train makes it; returns the batch that the policy got."""
    config = kind(**SMALL[kind], device="cpu", push_to_hub=False, **settings)
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
    for kind in SMALL:
        train(root, kind, state_keys=[STATE])
        train(root, kind, input_features={STATE: PolicyFeature(FeatureType.STATE, (6,))})


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("key", [FORCE, ENV])
def test_what_is_read_and_unusable_is_named_and_the_way_out_works(tmp_path, key, name):
    root = record(tmp_path / "set", {key: KINDS[name]})
    for kind in SMALL:
        with pytest.raises(DatasetError, match=f"{key}") as error:
            train(root, kind)
        setting = {
            FORCE: "--policy.state_keys='[observation.state]'",
            ENV: "--policy.input_features='{observation.state: {type: STATE, shape: [6]}}'",
        }[key]
        assert setting in str(error.value)
    train(root, kind, **{FORCE: {"state_keys": [STATE]}, ENV: {"input_features": {STATE: _state()}}}[key])


def _state() -> PolicyFeature:
    return PolicyFeature(FeatureType.STATE, (6,))


def test_unusable_actions_can_only_be_recorded_again(tmp_path):
    root = record(tmp_path / "set", {})
    config = ActChunkedConfig(chunk_size=5)
    features = LeRobotDataset("tests/read", root).meta.features
    features = {**features, "action": {**features["action"], "dtype": "int64"}}
    with pytest.raises(DatasetError, match=r"'action' holds int64\. Record it as float32"):
        config.check_dataset(features, LeRobotDataset("tests/read", root).meta)


def images(keys: tuple[str, ...]) -> dict[str, tuple[dict, Any]]:
    feature = {"dtype": "image", "shape": (32, 40, 3), "names": ["height", "width", "channels"]}
    return {key: (feature, lambda step: np.full((32, 40, 3), step, np.uint8)) for key in keys}


def test_cameras_that_are_not_read_are_not_decoded(tmp_path):
    root = record(tmp_path / "set", images((TOP, SIDE)))
    top = PolicyFeature(FeatureType.VISUAL, (3, 32, 40))
    batch = train(root, ActChunkedConfig, input_features={STATE: _state(), TOP: top})
    assert TOP in batch
    assert SIDE not in batch


def test_the_tokenizers_phase_decodes_no_images(tmp_path):
    root = record(tmp_path / "set", images((TOP,)))
    kind = VqbetChunkedConfig
    config = kind(**{**SMALL[kind], "n_vqvae_training_steps": 9}, device="cpu", push_to_hub=False)
    source = DatasetConfig("tests/read", root=str(root), use_imagenet_stats=False)
    dataset = factory.make_dataset(TrainPipelineConfig(source, policy=config, num_workers=0))
    policy = make_policy(config, ds_meta=dataset.meta)
    preprocessor, _ = make_pre_post_processors(config, dataset_stats=dataset.meta.stats)
    decoded = []
    for _ in range(12):
        batch = preprocessor(default_collate(dataset.__getitems__([0, 5, 20])))
        decoded.append(TOP in batch)
        policy.train().forward(batch)
    ahead = config.image_switch.ahead
    assert decoded == [False] * (10 - ahead) + [True] * (2 + ahead)
    # A resumed run finds the phase where it was, before its first batch.
    config.image_switch.want_images_in(100)
    policy.load_state_dict(policy.state_dict())
    assert TOP in dataset[0]


def test_images_are_wanted_again_before_workers_make_the_first_batch_that_is_looked_at():
    switch = VqbetChunkedConfig().image_switch
    switch.expect_workers(num_workers=4, prefetch_factor=5)
    switch.want_images_in(24)
    assert switch.off
    switch.want_images_in(23)
    assert not switch.off
