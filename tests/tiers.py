"""Two tiers of tests: the gate, and `.ci/full`, which draws more cases and runs what takes minutes."""

import os
import random
from collections.abc import Iterable

import pytest

FULL = os.environ.get("ACT_CHUNKING_FULL") == "1"

full_tier = pytest.mark.skipif(not FULL, reason="takes minutes: runs in .ci/full")


def some[Case](gate: int, cases: Iterable[Case]) -> list[Case]:
    """All of these in `.ci/full`, and so many of them, the same in every run, in the gate."""
    every = list(cases)
    if FULL or gate >= len(every):
        return every
    return [every[i] for i in sorted(random.Random(0).sample(range(len(every)), gate))]


def draws(gate: int, full: int) -> int:
    """How many random examples a property is tested on, in the gate and in `.ci/full`."""
    return full if FULL else gate
