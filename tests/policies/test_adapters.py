"""PEFT adapters without ``--peft.target_modules``: the modules that each policy names by default."""

import pytest
from adapter_checks import ADAPTED, check_learning, check_names, make


def case_id(case):
    return f"{case.type}-{case.name}"


@pytest.mark.parametrize("case", ADAPTED, ids=case_id)
def test_the_defaults_name_what_adapters_can_wrap_and_nothing_else(case):
    check_names(make(case))


@pytest.mark.parametrize("case", ADAPTED[::3], ids=case_id)
def test_adapters_learn_and_are_in_effect(case):
    check_learning(case, make(case))
