"""Every committed configuration parses into what lerobot-train would run."""

from pathlib import Path

import draccus
import pytest
import yaml
from lerobot.configs.train import TrainPipelineConfig

import lerobot_act_chunking.plugin  # noqa: F401

CONFIGS = sorted((Path(__file__).parents[1] / "configs").glob("*.yaml"))


def test_there_are_configs():
    assert CONFIGS


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_config_parses_offline_and_says_how_it_is_run(path):
    text = path.read_text()
    config = draccus.decode(TrainPipelineConfig, yaml.safe_load(text))
    assert config.policy is not None
    assert config.policy.push_to_hub is False
    assert config.dataset.root is not None
    assert f"lerobot-train --config_path=configs/{path.name}" in text
