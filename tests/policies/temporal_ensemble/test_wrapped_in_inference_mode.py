"""Acting under ``torch.inference_mode()`` and training behind it, over every inner policy."""

import pytest
from life_of_a_policy import assert_the_mode_does_not_matter
from wrapped_cases import CASES


@pytest.mark.parametrize("name", CASES)
def test_training_goes_on_after_acting_in_inference_mode(name):
    case = CASES[name]

    def policy():
        return case.wrapped(replan_interval=2)

    assert_the_mode_does_not_matter(policy, case.batch(), case.training_batch())
