"""Two tiers of tests: the gate, and `.ci/full`, which draws more cases and runs what takes minutes."""

import os
import random
from collections import Counter
from collections.abc import Callable, Iterable

import pytest

FULL = os.environ.get("ACT_CHUNKING_FULL") == "1"

full_tier = pytest.mark.skipif(not FULL, reason="takes minutes: runs in .ci/full")


def some[Case](gate: int, cases: Iterable[Case], by: Callable[[Case], object] = id) -> list[Case]:
    """All of these in `.ci/full`, and so many of them, the same in every run, in the gate.

    The gate's are taken in turns from the groups that ``by`` names: no group has two before each has one.
    """
    every = list(cases)
    if FULL or gate >= len(every):
        return every
    taken, turn = Counter[object](), {}
    for i in random.Random(0).sample(range(len(every)), len(every)):
        turn[i] = taken[by(every[i])]
        taken[by(every[i])] += 1
    return [every[i] for i in sorted(sorted(turn, key=turn.__getitem__)[:gate])]


def draws(gate: int, full: int) -> int:
    """How many random examples a property is tested on, in the gate and in `.ci/full`."""
    return full if FULL else gate
