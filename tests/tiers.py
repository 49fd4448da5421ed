"""Two tiers of tests: the gate, and `.ci/full`, which draws more cases and runs what takes minutes."""

import os

import pytest

FULL = os.environ.get("ACT_CHUNKING_FULL") == "1"

full_tier = pytest.mark.skipif(not FULL, reason="takes minutes: runs in .ci/full")


def draws(gate: int, full: int) -> int:
    """How many random examples a property is tested on, in the gate and in `.ci/full`."""
    return full if FULL else gate
