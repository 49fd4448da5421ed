"""Choosing among sampled chunks."""

import numpy as np

DISCOUNT = 0.5  # per step, as in the authors' code


def most_coherent(samples: np.ndarray, plan: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """The sample (n, T, A) of each environment that continues its current plan best.

    This is the backward coherence of Bidirectional Decoding (Liu et al. 2024, eq. 4): the discounted sum of
    distances over the steps that both cover, near steps counting most. With none it is the first sample.

    Args:
        samples: N chunks for each of n environments (N, n, T, A).
        plan: the current plan of each from this step on (n, P, A).
        covered: which of the plan's steps count (r, P); one row for all environments, or one for each.
    """
    n_common = min(samples.shape[2], plan.shape[1])
    distance = np.linalg.norm(samples[:, :, :n_common] - plan[:, :n_common], axis=-1)
    weight = covered[:, :n_common] * DISCOUNT ** np.arange(n_common)
    best = (distance * weight).sum(-1).argmin(0)  # (n,)
    return samples[best, np.arange(len(best))]
