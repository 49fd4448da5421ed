"""PEFT adapters in a wrapped policy, by the modules that the wrapper names."""

import pytest
from adapter_checks import ADAPTED, check_learning, check_names, make
from cases_temporal_ensemble import WRAPPED

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)
from lerobot_act_chunking.policies.temporal_ensemble.modeling_temporal_ensemble import TemporalEnsemblePolicy


def case_id(case):
    return f"{case.type}-{case.name}"


def wrapped(case):
    """The wrapper over the policy of a case."""
    config = case.config(use_ema=False)
    inner = make(case)
    policy = TemporalEnsemblePolicy(
        TemporalEnsembleConfig(
            inner=TemporalEnsembleConfig._encoded(config),
            input_features=dict(config.input_features),
            output_features=dict(config.output_features),
            device="cpu",
            push_to_hub=False,
            execution="open_loop",
        )
    )
    policy.inner.load_state_dict(inner.state_dict())
    return policy


@pytest.mark.parametrize("case", ADAPTED[::4], ids=case_id)
def test_the_defaults_name_what_adapters_can_wrap_and_nothing_else(case):
    check_names(wrapped(case))


@pytest.mark.parametrize("case", ADAPTED[::3], ids=case_id)
def test_adapters_learn_and_are_in_effect(case):
    check_learning(case, wrapped(case))


def test_averaged_weights_and_adapters_exclude_each_other():
    policy = WRAPPED[0].policy()
    policy.config.pretrained_path = "somewhere"
    with pytest.raises(ConfigurationError, match="use_ema does not follow PEFT adapters"):
        policy._validate_peft_config(None)
