"""Chunks that are made from the one in execution are not exported."""

import pytest
from policy_case import STATE, Case

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.exporting.acting import acting_of


@pytest.mark.parametrize("start", ["rtc", "sdedit"])
def test_what_needs_the_chunk_in_execution_is_refused(start):
    policy = Case("", "diffusion_chunked", STATE, {"warm_start": start, "replan_interval": 2}).policy()
    with pytest.raises(ConfigurationError, match=f"warm_start={start} .* --policy.warm_start=none"):
        acting_of(policy)
