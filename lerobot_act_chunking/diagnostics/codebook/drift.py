"""Whether other data still fit the codes that the training data made."""

from dataclasses import dataclass

import numpy as np

from lerobot_act_chunking.diagnostics.codebook.chunks import CodedChunks
from lerobot_act_chunking.diagnostics.codebook.usage import histograms

RARE = 99.0
"""Percentile of the training chunks' errors beyond which a chunk counts as unlike them."""
SPLITS = 20


@dataclass(frozen=True)
class Drift:
    """Other data against the training data.

    Attributes:
        folder: of the other dataset.
        chunks: how many of it were coded.
        distances: Jensen-Shannon distance (0 alike, 1 nothing in common) of the histograms of each code.
        expected: the same between as many training episodes and the remaining ones, 95th percentile over
            random choices, largest over codes; None for a single training episode.
        error_ratio: RMS error in normalised units, that of the training data being 1.
        beyond: share of chunks whose error exceeds that of 99 % of the training chunks.
    """

    folder: str
    chunks: int
    distances: list[float]
    expected: float | None
    error_ratio: float
    beyond: float

    @property
    def largest(self) -> float:
        """Distance of the code that differs most."""
        return max(self.distances)


def measure_drift(
    training: CodedChunks, other: CodedChunks, vocabulary: int, folder: str, *, seed: int
) -> Drift:
    """Compare the codes and errors of two sets of chunks.

    Args:
        training: what the tokenizer learned from.
        other: chunks of the dataset to compare with.
        vocabulary: M.
        folder: of the other dataset.
        seed: of the random choices of training episodes.
    """
    errors, others = training.chunk_errors, other.errors_of(training.chunks.moving)
    ratio = np.sqrt((others**2).mean() / max((errors**2).mean(), 1e-24))
    return Drift(
        folder=folder,
        chunks=len(other.codes),
        distances=_distances(training.codes, other.codes, vocabulary).tolist(),
        expected=_expected(training, len(np.unique(other.chunks.episode)), vocabulary, seed),
        error_ratio=float(ratio),
        beyond=float((others > np.percentile(errors, RARE)).mean()),
    )


def _distances(codes: np.ndarray, others: np.ndarray, vocabulary: int) -> np.ndarray:
    """Jensen-Shannon distance (G,) of the histograms of codes (N, G) and (M, G), base 2."""
    from scipy.spatial.distance import jensenshannon

    pairs = zip(histograms(codes, vocabulary), histograms(others, vocabulary), strict=True)
    return np.array([jensenshannon(one, two, base=2) for one, two in pairs])


def _expected(training: CodedChunks, n_episodes: int, vocabulary: int, seed: int) -> float | None:
    """Distances that chance alone makes: whole episodes, because chunks of one resemble each other."""
    episodes = np.unique(training.chunks.episode)
    if len(episodes) < 2:
        return None
    rng = np.random.default_rng(seed)
    n_chosen = min(n_episodes, len(episodes) // 2)
    found = []
    for _ in range(SPLITS):
        chosen = np.isin(training.chunks.episode, rng.choice(episodes, n_chosen, replace=False))
        found.append(_distances(training.codes[~chosen], training.codes[chosen], vocabulary).max())
    return float(np.percentile(found, 95))
