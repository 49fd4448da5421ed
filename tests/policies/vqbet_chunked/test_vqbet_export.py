"""A policy without codes is not exported."""

import pytest
from lerobot.policies.factory import get_policy_class
from policy_case import STATE, Case

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.exporting.acting import acting_of


def test_codes_that_were_not_learned_are_refused():
    policy = get_policy_class("vqbet_chunked")(Case("", "vqbet_chunked", STATE).config())
    with pytest.raises(ConfigurationError, match="has not learned yet"):
        acting_of(policy)
