"""Acting under ``torch.inference_mode()``, as LeRobot evaluates, leaves nothing that training trips over."""

import pytest
from life_of_a_policy import assert_the_mode_does_not_matter
from policy_cases import CASES, WRAPPED, history_batch, of_every_type
from tiers import some

ALL = some(8, [*CASES, *WRAPPED, *of_every_type("KEPT")], by=lambda case: case.type)


@pytest.mark.parametrize("case", ALL, ids=lambda case: f"{case.type}-{case.name}")
def test_training_goes_on_after_acting_in_inference_mode(case):
    batch = history_batch(case.policy()) if case.config().n_obs_steps > 1 else case.batch()
    observation = {key: value for key, value in case.batch().items() if key.startswith("observation")}
    assert_the_mode_does_not_matter(case.policy, observation, batch)
