"""How often each way is taken, beside how often it was demonstrated; pure counting."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Int64

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.diagnostics.modes.settings import Thresholds

DRAWS = 20_000  # of the proportions, for the p-value


@dataclass(frozen=True)
class Frequencies:
    """Episodes or chunks by the way they go.

    Attributes:
        counts: of each of the M ways.
        invalid: how many go none of them.
        proportions: share of the demonstrations of each way; 1 together.
    """

    counts: tuple[int, ...]
    invalid: int
    proportions: tuple[float, ...]

    @classmethod
    def of(
        cls, modes: Sequence[int] | Int64[np.ndarray, " n"], proportions: Sequence[float]
    ) -> "Frequencies":
        """Count ways 0 to M - 1; all others are none of them."""
        found = np.asarray(modes, int)
        known = (found >= 0) & (found < len(proportions))
        counts = np.bincount(found[known], minlength=len(proportions))
        return cls(tuple(counts.tolist()), int((~known).sum()), tuple(proportions))

    @property
    def n(self) -> int:
        """All that were counted."""
        return sum(self.counts) + self.invalid

    @property
    def shares(self) -> list[float]:
        """Of each way; with that of the invalid ones 1 together."""
        return [count / self.n for count in self.counts]

    @property
    def invalid_share(self) -> float:
        """Of those that go no way."""
        return self.invalid / self.n

    @property
    def intervals(self) -> list[tuple[float, float]]:
        """95 % Clopper-Pearson intervals of the shares, each on its own."""
        return [SuccessRate(count, self.n).exact_interval for count in self.counts]

    def missing(self, thresholds: Thresholds) -> list[int]:
        """Demonstrated ways that are not covered."""
        return [
            mode
            for mode, (share, shown) in enumerate(zip(self.shares, self.proportions, strict=True))
            if shown > 0 and share < thresholds.covered * shown
        ]

    def good(self, thresholds: Thresholds) -> bool:
        """Whether all demonstrated ways are covered, and hardly any other is taken."""
        return not self.missing(thresholds) and self.invalid_share <= thresholds.invalid

    @property
    def balanced_coverage(self) -> float:
        """M times the least share: 1 if all ways are taken equally often, 0 if one never is."""
        return len(self.counts) * min(self.shares)

    @property
    def divergence(self) -> float | None:
        """KL(taken || demonstrated) [nats] of the valid ones; None without any, or of undemonstrated ways."""
        return self._divergence(self.proportions)

    @property
    def divergence_from_uniform(self) -> float | None:
        """The same from equal shares."""
        return self._divergence((1 / len(self.counts),) * len(self.counts))

    def _divergence(self, reference: Sequence[float]) -> float | None:
        valid = sum(self.counts)
        if not valid or any(count and not share for count, share in zip(self.counts, reference, strict=True)):
            return None
        taken = [(count / valid, share) for count, share in zip(self.counts, reference, strict=True) if count]
        return max(0.0, sum(p * math.log(p / share) for p, share in taken))

    @cached_property
    def p_value(self) -> float | None:
        """Could valid ones in these proportions come out like this? The exact multinomial test, by sampling.

        The share of `DRAWS` draws that are no likelier than what was found; None without valid ones.
        """
        valid, shares = sum(self.counts), np.array(self.proportions)
        if not valid:
            return None
        if any(count and not share for count, share in zip(self.counts, shares, strict=True)):
            return 0.0
        drawn = np.random.default_rng(0).multinomial(valid, shares / shares.sum(), size=DRAWS)
        found = _log_likelihood(np.array(self.counts), shares)
        as_rare = _log_likelihood(drawn, shares) <= found + 1e-9
        return float((1 + as_rare.sum()) / (1 + DRAWS))

    def to_json(self, thresholds: Thresholds) -> dict[str, Any]:
        """Plain numbers and lists."""
        return {
            "n": self.n,
            "counts": list(self.counts),
            "invalid": self.invalid,
            "shares": self.shares,
            "intervals": [list(each) for each in self.intervals],
            "invalid_share": self.invalid_share,
            "missing": self.missing(thresholds),
            "balanced_coverage": self.balanced_coverage,
            "kl": self.divergence,
            "kl_from_uniform": self.divergence_from_uniform,
            "p_value": self.p_value,
        }


def _log_likelihood(counts: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Of counts (..., M) under a multinomial distribution, up to a constant."""
    from scipy.special import gammaln, xlogy

    return (xlogy(counts, shares) - gammaln(counts + 1)).sum(-1)
