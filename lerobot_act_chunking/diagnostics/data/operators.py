"""Whom to hold out for validation."""

from collections import Counter
from dataclasses import dataclass

HELD_OUT = 0.2
"""Share of the episodes that validation takes, as nearly as whole operators allow."""


@dataclass(frozen=True)
class Split:
    """Training and validation by different people.

    Attributes:
        counts: episodes by operator.
        held_out: the operator to validate on.
        train: episodes of all others.
        validation: episodes of this one.
    """

    counts: dict[str, int]
    held_out: str
    train: list[int]
    validation: list[int]


def split_by_operator(operators: dict[int, str]) -> Split | None:
    """Hold out the operator whose share of the episodes is nearest to a fifth; None of fewer than two."""
    counts = Counter(operators.values())
    if len(counts) < 2:
        return None
    wanted = HELD_OUT * len(operators)
    held_out = min(sorted(counts), key=lambda name: abs(counts[name] - wanted))
    return Split(
        counts=dict(sorted(counts.items())),
        held_out=held_out,
        train=[each for each, name in operators.items() if name != held_out],
        validation=[each for each, name in operators.items() if name == held_out],
    )
