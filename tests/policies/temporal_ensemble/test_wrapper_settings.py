"""What the wrapper's settings are held to, as those of every policy."""

import pytest
from cases_temporal_ensemble import INNER, NEEDED, WRAPPED
from policy_cases import SIZES

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.settings_reference import settings_of
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)


def test_the_reference_shows_its_defaults_and_no_presets():
    execution = next(setting for setting in settings_of("temporal_ensemble") if setting.name == "execution")
    assert execution.values == {"default": "ensemble"}
    with pytest.raises(ConfigurationError, match="choose one of: none, it has no presets"):
        settings_of("temporal_ensemble", "base")


def test_grippers_beyond_the_action_are_refused():
    features = WRAPPED[0].config()
    given = {"input_features": features.input_features, "output_features": features.output_features}
    TemporalEnsembleConfig(**NEEDED, device="cpu", gripper_dims=[3], **given)
    with pytest.raises(ConfigurationError, match=r"gripper_dims=\[4\] must be .* dimensions, 0 to 3"):
        TemporalEnsembleConfig(**NEEDED, device="cpu", gripper_dims=[4], **given)


def test_it_observes_what_its_inner_policy_does():
    inner = {"type": INNER, **SIZES[INNER], "n_obs_steps": 2}
    assert TemporalEnsembleConfig(device="cpu", inner=inner).n_obs_steps == 2
    with pytest.raises(ConfigurationError, match=f"n_obs_steps=1: the inner {INNER} observes 2 steps"):
        TemporalEnsembleConfig(device="cpu", inner=inner, n_obs_steps=1)
