"""How many ways there are to do the task: groups of demonstrations with nothing in between."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

FEWEST_EPISODES = 12
SAMPLES = 32
"""Moments at which motions of different length are compared, evenly spread over each."""
NEIGHBOURS = 2
"""Demonstrations that must be as near for one to count as near: a single odd one bridges no gap."""
FEWEST_ALIKE = 4
"""Demonstrations that make a way; fewer are odd ones."""
MOST_ODD = 0.2
"""Share of odd demonstrations up to which groups are believed."""
BY_START = 0.9
"""Share of the demonstrations whose group their start tells, from which the groups are no choice."""


@dataclass(frozen=True)
class Ways:
    """Groups of demonstrations.

    Attributes:
        number: how many there are; None where there are too few demonstrations to say.
        groups: episodes of each way, the commonest first.
        odd: episodes that are like no others.
        by_start: whether the first state tells the group, so that there is nothing to choose.
    """

    number: int | None
    groups: tuple[tuple[int, ...], ...] = ()
    odd: tuple[int, ...] = ()
    by_start: bool = False


def count_ways(
    motions: Sequence[np.ndarray], starts: np.ndarray, scale: np.ndarray, indices: Sequence[int]
) -> Ways:
    """Group demonstrations whose motions are close, with a gap to all others.

    Motions are brought to one length, and single linkage by mutual reachability (Campello, Moulavi & Sander
    2013) is cut at its widest step. Groups that begin in different places are reactions to these, not ways.

    Args:
        motions: (L, D) of each episode, from the first motion to the last.
        starts: (E, S) first states or actions, in units that make dimensions comparable.
        scale: (D,) standard deviations.
        indices: of the episodes.
    """
    if len(motions) < FEWEST_EPISODES:
        return Ways(None)
    paths = np.stack([_resampled(rows / scale).ravel() for rows in motions])
    label = _grouped(paths)
    groups = [np.flatnonzero(label == each) for each in range(label.max() + 1)]
    groups.sort(key=len, reverse=True)
    by_start = len(groups) > 1 and _told_by_start(starts, label)
    return Ways(
        number=1 if by_start else len(groups),
        groups=tuple(tuple(indices[each] for each in group) for group in groups),
        odd=tuple(indices[each] for each in np.flatnonzero(label < 0)),
        by_start=by_start,
    )


def _resampled(rows: np.ndarray) -> np.ndarray:
    """(SAMPLES, D) evenly spread over the motion."""
    at = np.linspace(0, len(rows) - 1, SAMPLES)
    return np.stack([np.interp(at, np.arange(len(rows)), rows[:, dim]) for dim in range(rows.shape[1])], 1)


def _distances(paths: np.ndarray) -> np.ndarray:
    """(E, E) mutual reachability: the distance, or that to the NEIGHBOURS-th nearest where it is longer."""
    from scipy.spatial.distance import cdist

    apart = cdist(paths, paths)
    core = np.sort(apart, axis=1)[:, NEIGHBOURS]
    return np.maximum(apart, np.maximum(core[:, None], core))


def _grouped(paths: np.ndarray) -> np.ndarray:
    """(E,) group of each path (E, P), -1 for odd ones; all are one group where no gap is wide enough."""
    from scipy.cluster.hierarchy import fcluster, linkage
    from scipy.spatial.distance import squareform

    tree = linkage(squareform(_distances(paths), checks=False), "single")
    heights = np.unique(tree[:, 2])
    for within, between in zip(heights[-2::-1], heights[:0:-1], strict=True):
        label = _without_odd(fcluster(tree, within, "distance"))
        if label.max() > 0 and (label < 0).mean() <= MOST_ODD and between > _wide(paths, label) * within:
            return label
    return np.zeros(len(paths), int)


def _wide(paths: np.ndarray, label: np.ndarray) -> float:
    """How much wider than any gap within a group the gap between groups must be.

    Twice as wide where demonstrations differ in one way, as uneven gaps are common on a line; less where they
    differ in many, by the number of independent directions (participation ratio) within the groups.
    """
    within = np.concatenate([paths[label == each] - paths[label == each].mean(0) for each in set(label)])
    power = np.square(np.linalg.svd(within, compute_uv=False))
    directions = power.sum() ** 2 / np.square(power).sum() if power.any() else 1.0
    return 1 + float(directions) ** -0.5


def _without_odd(cluster: np.ndarray) -> np.ndarray:
    """Groups from 0 on; -1 where there are too few."""
    names, sizes = np.unique(cluster, return_counts=True)
    kept = {name: place for place, name in enumerate(names[sizes >= FEWEST_ALIKE])}
    return np.array([kept.get(each, -1) for each in cluster])


def _told_by_start(starts: np.ndarray, label: np.ndarray) -> bool:
    """Whether the nearest other start is in the same group, nearly always."""
    from scipy.spatial.distance import cdist

    known = label >= 0
    apart = cdist(starts[known], starts[known])
    np.fill_diagonal(apart, np.inf)
    return bool((label[known][apart.argmin(1)] == label[known]).mean() >= BY_START)
