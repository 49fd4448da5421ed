"""Whether a policy has several ways of doing it: clusters among its samples for one observation."""

from dataclasses import dataclass

import numpy as np

from lerobot_act_chunking.diagnostics.core.measures import distances
from lerobot_act_chunking.diagnostics.steps.statistics import chunk_distances, chunk_error

CLEAR = 0.75
"""Silhouette from which clusters count as modes. Sixteen samples on a line get there by chance in 1 of 40
cases, in a plane hardly ever; two modes need to be about 7 standard deviations apart."""
FEWEST_OBSERVATIONS = 0.1
"""Share of observations that must show several modes; fewer are chance."""
MOST_MODES = 4
_FEWEST_SAMPLES = 2  # of a mode; a single sample is an outlier


@dataclass(frozen=True)
class Modes:
    """How one observation's reference samples cluster.

    Attributes:
        labels: (N,) mode of each sample, 0 for the largest.
        samples: the samples (N, T, P, C) themselves.
        separation: smallest distance between two modes, that of their typical members, measured as paired
            errors are (the step and point that are farthest apart); infinite for one mode.
    """

    labels: np.ndarray
    samples: np.ndarray
    separation: float

    @property
    def count(self) -> int:
        """Number of modes, at least 1."""
        return int(self.labels.max()) + 1

    def masses(self, samples: np.ndarray | None = None) -> np.ndarray:
        """Share (count,) of samples in each mode: of the reference's own, or of others by their nearest."""
        labels = self.labels if samples is None else self.assign(samples)
        return np.bincount(labels, minlength=self.count) / len(labels)

    def assign(self, samples: np.ndarray) -> np.ndarray:
        """The mode (M,) whose mean is nearest to each of other samples (M, T, P, C)."""
        means = np.stack([self.samples[self.labels == mode].mean(0) for mode in range(self.count)])
        return chunk_distances(samples, means).argmin(1)


def one_mode(samples: np.ndarray) -> Modes:
    """All samples (N, T, P, C) in one mode."""
    return Modes(np.zeros(len(samples), int), samples, np.inf)


def find_all_modes(observations: list[np.ndarray], tolerance: float) -> list[Modes]:
    """The modes of each observation's samples; one for all, if hardly any observation shows more."""
    found = [find_modes(samples, tolerance) for samples in observations]
    several = sum(modes.count > 1 for modes in found)
    if several < FEWEST_OBSERVATIONS * len(found):
        return [one_mode(samples) for samples in observations]
    return found


def find_modes(samples: np.ndarray, tolerance: float) -> Modes:
    """Cluster the samples (N, T, P, C) of one observation, by average linkage.

    The number of clusters has the best mean silhouette (Rousseeuw 1987). One mode, unless that is clear, no
    cluster is a single sample, and the clusters are farther apart than the tolerance.
    """
    from scipy.cluster.hierarchy import fcluster, linkage
    from scipy.spatial.distance import squareform

    one = one_mode(samples)
    apart = chunk_distances(samples, samples)
    apart = (apart + apart.T) / 2
    np.fill_diagonal(apart, 0)
    if len(samples) < 2 * _FEWEST_SAMPLES or not apart.any():
        return one
    tree = linkage(squareform(apart, checks=False), "average")
    best, clearest = one, CLEAR
    for count in range(2, MOST_MODES + 1):
        labels = _by_size(fcluster(tree, count, "maxclust"))
        sizes = np.bincount(labels)
        if len(sizes) < count or sizes.min() < _FEWEST_SAMPLES:
            continue
        clarity = silhouette(apart, labels)
        if clarity > clearest:
            best, clearest = Modes(labels, samples, _separation(samples, labels)), clarity
    return best if best.separation > tolerance else one


def silhouette(apart: np.ndarray, labels: np.ndarray) -> float:
    """Mean silhouette of clusters: 1 if they are far apart, about 0 if they touch.

    Args:
        apart: (N, N) distances.
        labels: (N,) clusters from 0 on, each with two samples or more.
    """
    members = np.eye(labels.max() + 1)[labels]  # (N, clusters)
    sizes = members.sum(0)
    sums = apart @ members
    rows = np.arange(len(labels))
    own = sums[rows, labels] / (sizes[labels] - 1)
    others = sums / sizes
    others[rows, labels] = np.inf
    nearest = others.min(1)
    return float(((nearest - own) / np.maximum(np.maximum(nearest, own), 1e-12)).mean())


def _by_size(labels: np.ndarray) -> np.ndarray:
    """Clusters renumbered from 0, the largest first."""
    _, index, sizes = np.unique(labels, return_inverse=True, return_counts=True)
    rank = np.argsort(np.argsort(-sizes, kind="stable"), kind="stable")
    return rank[index]


def _separation(samples: np.ndarray, labels: np.ndarray) -> float:
    groups = [samples[labels == mode] for mode in range(labels.max() + 1)]
    return min(
        float(np.median(chunk_error(distances(one[:, None], other[None]))))
        for i, one in enumerate(groups)
        for other in groups[:i]
    )
