"""The arithmetic of the sweep: distances between sets of samples, orders of convergence, quantiles.

Samples of one observation are points (N, T, P, C): N noises, T control steps, P points of C coordinates.
"""

from collections.abc import Sequence

import numpy as np

MIN_CELLS_FOR_ORDER = 3
_ASYMPTOTIC_FROM = 5  # steps; below, the error is not yet a power of the step size
_ABOVE_FLOOR = 5.0  # times the reference's own error


def quantiles(values: np.ndarray) -> dict[str, float] | None:
    """Median, 95th percentile, maximum and number of finite values; None if there are none."""
    kept = np.asarray(values)[np.isfinite(values)]
    if not kept.size:
        return None
    p50, p95 = np.percentile(kept, [50, 95])
    return {"p50": float(p50), "p95": float(p95), "max": float(kept.max()), "count": int(kept.size)}


def chunk_error(step_errors: np.ndarray, at: np.ndarray | None = None) -> np.ndarray:
    """Largest error (...) of each chunk of errors (..., T), over all steps or those marked; NaN for none."""
    if at is None:
        return step_errors.max(-1)
    worst = np.where(at, step_errors, -np.inf).max(-1)
    return np.where(np.isneginf(worst), np.nan, worst)


def chunk_distances(samples: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Distances (N, M) between samples (N, T, P, C) and (M, T, P, C): RMS over the steps, summed over points.

    This is the Euclidean distance of the flattened chunks over the root of their length, which energy
    distances need (they are only zero for equal distributions because it is of negative type).
    """
    one, two = (part.reshape(len(part), -1) / np.sqrt(part.shape[1]) for part in (samples, others))
    squares = (one**2).sum(1)[:, None] + (two**2).sum(1) - 2 * one @ two.T
    return np.sqrt(np.maximum(squares, 0.0))


def energy_distance(samples: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """Energy distance of two sets of samples (N, T, P, C) that started from the same noises.

    ``2 E|X - Y| - E|X - X'| - E|Y - Y'|`` (Szekely and Rizzo 2013), zero for equal distributions only. Equal
    noises do not make it a paired figure: every mean leaves out the pairs that share their noise, so it is
    unbiased, and since both sets have the same luck with their noises, it varies little.

    Returns:
        The distance, in the unit of the samples, and ``2 E|X - Y|``, its largest possible value.
    """
    across, within, within_reference = (
        _mean_of_unequal(chunk_distances(a, b))
        for a, b in ((samples, reference), (samples, samples), (reference, reference))
    )
    return 2 * across - within - within_reference, 2 * across


def _mean_of_unequal(distances: np.ndarray) -> float:
    n = len(distances)
    return float((distances.sum() - np.trace(distances)) / (n * (n - 1)))


def spread(samples: np.ndarray, modes: np.ndarray | None = None) -> np.ndarray:
    """RMS distance (T,) of samples (N, T, P, C) from their mean, of the point that spreads most.

    Args:
        samples: chunks of one observation.
        modes: (N,) mode of each sample, whose mean it is held against in place of the mean of all.
    """
    labels = np.zeros(len(samples), int) if modes is None else modes
    _, labels = np.unique(labels, return_inverse=True)
    means = np.stack([samples[labels == mode].mean(0) for mode in range(labels.max() + 1)])
    squares = ((samples - means[labels]) ** 2).sum(-1).sum(0)
    return np.sqrt(squares / max(1, len(samples) - len(means))).max(-1)


def observed_order(n_steps: Sequence[int], errors: Sequence[float], floor: float) -> float | None:
    """The p of ``error ~ n ** -p``, by least squares on logarithms.

    Args:
        n_steps: step counts.
        errors: their median errors.
        floor: error of the reference that they were measured against; errors near it are left out.

    Returns:
        None with fewer than three usable step counts.
    """
    usable = [
        (n, error)
        for n, error in zip(n_steps, errors, strict=True)
        if n >= _ASYMPTOTIC_FROM and error > max(_ABOVE_FLOOR * floor, 0.0)
    ]
    if len(usable) < MIN_CELLS_FOR_ORDER:
        return None
    n, error = np.array(usable).T
    return float(-np.polyfit(np.log(n), np.log(error), 1)[0])
