"""What ``pretrained_backbone_weights=auto`` of a wrapped policy chose is in the wrapper's checkpoint."""

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from policy_case import STATE, TOP
from policy_cases import SIZES

from lerobot_act_chunking.policies import backbone_choice
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)
from lerobot_act_chunking.policies.temporal_ensemble.modeling_temporal_ensemble import TemporalEnsemblePolicy


@pytest.mark.parametrize("kind", list(SIZES)[:1])
def test_it_is_loaded_as_it_was_chosen(kind, tmp_path, monkeypatch):
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))
    monkeypatch.setattr(backbone_choice.constants, "HF_HUB_OFFLINE", True)
    config = TemporalEnsembleConfig(
        inner={"type": kind, **SIZES[kind], "vision_backbone": None},
        device="cpu",
        push_to_hub=False,
        input_features=STATE | TOP,
        output_features={"action": PolicyFeature(FeatureType.ACTION, (4,))},
    )
    policy = TemporalEnsemblePolicy(config)
    assert policy.config.inner["vision_backbone"] == "efficientnet_lite0"
    policy.save_pretrained(tmp_path / "checkpoint")
    monkeypatch.setattr(backbone_choice, "_weights_of", None)
    loaded = TemporalEnsemblePolicy.from_pretrained(tmp_path / "checkpoint")
    for name, value in policy.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], value), name
