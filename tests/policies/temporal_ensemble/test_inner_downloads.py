"""A fresh inner policy whose image backbone would be downloaded is refused where nothing may be."""

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.temporal_ensemble import inner
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)
from lerobot_act_chunking.policies.temporal_ensemble.modeling_temporal_ensemble import TemporalEnsemblePolicy

SMALL = {
    "dim_model": 16,
    "n_heads": 2,
    "dim_feedforward": 24,
    "n_encoder_layers": 1,
    "n_vae_encoder_layers": 1,
}


@pytest.fixture(autouse=True)
def offline_without_weights(monkeypatch, tmp_path):
    monkeypatch.setattr(inner, "HF_HUB_OFFLINE", True)
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))


def wrapped_act(**settings):
    return TemporalEnsembleConfig(
        inner={"type": "act", **SMALL, **settings},
        input_features={"observation.images.top": PolicyFeature(FeatureType.VISUAL, (3, 32, 48))}
        | {"observation.state": PolicyFeature(FeatureType.STATE, (6,))},
        output_features={"action": PolicyFeature(FeatureType.ACTION, (4,))},
        device="cpu",
    )


def test_weights_that_would_be_downloaded_are_refused_with_a_way_out():
    config = wrapped_act()
    with pytest.raises(ConfigurationError, match=r"pretrained_backbone_weights: null.*--policy\.inner_path"):
        TemporalEnsemblePolicy(config)


def test_the_way_out_works(tmp_path):
    policy = TemporalEnsemblePolicy(wrapped_act(pretrained_backbone_weights=None))
    policy.save_pretrained(tmp_path)
    assert TemporalEnsemblePolicy.from_pretrained(tmp_path).config.inner == policy.config.inner


def test_a_checkpoint_needs_no_download(tmp_path):
    policy = TemporalEnsemblePolicy(wrapped_act(pretrained_backbone_weights=None))
    policy.config.inner_config.pretrained_backbone_weights = "ResNet18_Weights.IMAGENET1K_V1"
    policy.save_pretrained(tmp_path)
    TemporalEnsemblePolicy.from_pretrained(tmp_path)
