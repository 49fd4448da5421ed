"""An observation without a batch axis is refused by its name, with the cure."""

import pytest
import torch
from policy_cases import CASES as OWN
from wrapped_cases import CASES as INNER

from lerobot_act_chunking.errors import FeatureError

POLICIES = {f"{case.type}-{case.name}": case.policy for case in OWN[::4]}
POLICIES |= {f"wrapper-{name}": case.wrapped for name, case in INNER.items()}


@pytest.mark.parametrize("name", POLICIES)
def test_a_single_observation_is_named_and_told_the_cure(name):
    policy = POLICIES[name]()
    single = {key: torch.rand(feature.shape) for key, feature in policy.config.input_features.items()}
    key = next(iter(single))
    for use in (policy.select_action, policy.predict_action_chunk):
        with pytest.raises(FeatureError, match=rf"'{key}' has shape .*unsqueeze\(0\)"):
            use(dict(single))
        policy.reset()
    batch = {key: value.unsqueeze(0) for key, value in single.items()}
    assert policy.select_action(batch).shape[0] == 1
