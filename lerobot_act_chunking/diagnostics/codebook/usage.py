"""How much of a codebook is in use."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class LevelUsage:
    """One code of a chunk.

    Attributes:
        counts: chunks with each of its values.
        perplexity: values it would have if all were used alike, ``exp(entropy)``.
    """

    counts: list[int]
    perplexity: float

    @property
    def used(self) -> int:
        """Number of values that occur."""
        return sum(n > 0 for n in self.counts)

    @property
    def dead(self) -> list[int]:
        """Values that never occur."""
        return [code for code, n in enumerate(self.counts) if not n]


@dataclass(frozen=True)
class Usage:
    """All codes of a chunk.

    Attributes:
        levels: one for each of the G codes.
        vocabulary: M, values of a code.
        combinations: different sequences of G codes that occur.
        chunks: how many chunks were counted.
    """

    levels: list[LevelUsage]
    vocabulary: int
    combinations: int
    chunks: int

    @property
    def bits(self) -> float:
        """Of a chunk if every value costs the same, G log2 M."""
        return float(len(self.levels) * np.log2(self.vocabulary))

    @property
    def entropy_bits(self) -> float:
        """Of a chunk if frequent values cost less: the sum of the codes' entropies."""
        return float(sum(np.log2(level.perplexity) for level in self.levels))

    @property
    def share_of_combinations(self) -> float:
        """Used combinations among all M^G."""
        return float(self.combinations * 2.0**-self.bits)

    @property
    def share_dead(self) -> float:
        """Dead values, on the level that has most of them."""
        return max(len(level.dead) for level in self.levels) / self.vocabulary


def measure_usage(codes: np.ndarray, vocabulary: int) -> Usage:
    """Count codes (N, G) of 0 .. vocabulary - 1."""
    levels = [_level(histogram) for histogram in histograms(codes, vocabulary)]
    return Usage(levels, vocabulary, len(np.unique(codes, axis=0)), len(codes))


def histograms(codes: np.ndarray, vocabulary: int) -> np.ndarray:
    """Counts (G, M) of each value of each code (N, G)."""
    return np.stack([np.bincount(code, minlength=vocabulary) for code in codes.T])


def _level(counts: np.ndarray) -> LevelUsage:
    shares = counts[counts > 0] / counts.sum()
    return LevelUsage(counts.tolist(), float(np.exp(-(shares * np.log(shares)).sum())))
