"""Chunks that continue the one in execution are not exported."""

import pytest
from policy_case import STATE, Case

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.exporting.acting import acting_of


def test_what_needs_the_chunk_in_execution_is_refused():
    settings = {"prefix_steps": 2, "execution": "receding", "replan_interval": 2}
    policy = Case("", "act_chunked", STATE, settings).policy()
    with pytest.raises(ConfigurationError, match="prefix_steps=2 continues the chunk in execution"):
        acting_of(policy)
