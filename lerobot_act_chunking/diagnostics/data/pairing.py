"""Which number of the state is which of the action."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

LEAST_LIKENESS = 0.9
"""Correlation from which two dimensions of different names are taken for the same joint."""


@dataclass(frozen=True)
class Pairs:
    """Dimensions that belong together.

    Attributes:
        actions: dimensions of the action.
        states: those of the state, in the same order.
        note: how that is known, in a sentence; None where action and state have the same names.
    """

    actions: tuple[int, ...]
    states: tuple[int, ...]
    note: str | None


def pair_dimensions(
    actions: np.ndarray, states: np.ndarray, action_names: Sequence[str], state_names: Sequence[str]
) -> Pairs:
    """Pair by place where there are as many of both, else by likeness.

    Args:
        actions: (F, A) of all episodes.
        states: (F, S) of the same frames.
        action_names: of the A dimensions.
        state_names: of the S dimensions.
    """
    width = len(action_names)
    if not len(state_names):
        return Pairs((), (), "There is no observation.state: how the robot follows its commands is unknown.")
    if width == len(state_names):
        same = tuple(action_names) == tuple(state_names)
        note = None if same else "Actions and states have different names, and are taken to be in one order."
        return Pairs(tuple(range(width)), tuple(range(width)), note)
    ours, theirs = _alike(actions, states)
    named = ", ".join(
        f"{action_names[a]} = {state_names[s]}" if action_names[a] != state_names[s] else action_names[a]
        for a, s in zip(ours, theirs, strict=True)
    )
    found = f"paired by how they move: {named}" if named else "and none moves like another"
    note = f"There are {width} actions, but {len(state_names)} states, {found}."
    return Pairs(ours, theirs, note)


def _alike(actions: np.ndarray, states: np.ndarray) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Pairs of the greatest correlation in sum, of which each has enough."""
    from scipy.optimize import linear_sum_assignment

    ours, theirs = (_standardised(rows) for rows in (actions, states))
    correlation = ours.T @ theirs / len(ours)
    pairs = [
        (int(a), int(s))
        for a, s in zip(*linear_sum_assignment(-correlation), strict=True)
        if correlation[a, s] >= LEAST_LIKENESS
    ]
    return tuple(a for a, _ in pairs), tuple(s for _, s in pairs)


def _standardised(rows: np.ndarray) -> np.ndarray:
    spread = rows.std(0)
    return np.where(spread > 0, (rows - rows.mean(0)) / np.where(spread > 0, spread, 1.0), 0.0)
