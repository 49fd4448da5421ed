"""Whether failing episodes start where no demonstration does."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lerobot_act_chunking.diagnostics.diagnose.causes import HALF, LEVEL, Finding

ROOM = 0.05
"""How far beyond the demonstrations' starts, as a share of their range, a start still is inside."""


@dataclass(frozen=True)
class Outside:
    """Starts beyond those of the demonstrations.

    Attributes:
        failing: failing episodes that start outside, and all.
        succeeding: the same of succeeding ones.
        p_value: of Fisher's exact test, one-sided.
        by: the numbers that are outside most often.
    """

    failing: tuple[int, int]
    succeeding: tuple[int, int]
    p_value: float
    by: str

    @property
    def share(self) -> float:
        """Share of the failures that would go if starts outside failed as rarely as those inside."""
        (out, failures), (out_good, successes) = self.failing, self.succeeding
        inside_failing, inside_all = failures - out, failures - out + successes - out_good
        if not out or not failures:
            return 0.0
        base = inside_failing / inside_all if inside_all else 0.0
        return max(0.0, (out - base * (out + out_good)) / failures)


def starts_outside(
    demonstrated: Mapping[str, np.ndarray], observed: Mapping[str, np.ndarray], success: np.ndarray
) -> Outside:
    """Which episodes start where no demonstration does.

    Args:
        demonstrated: starts (E, D) of the demonstrations, by key.
        observed: starts (N, D) of the episodes.
        success: of the episodes, (N,).
    """
    from scipy.stats import fisher_exact

    outside, counts = np.zeros(len(success), bool), dict[str, int]()
    for key, shown in demonstrated.items():
        here = observed.get(key)
        if here is None or here.shape[1:] != shown.shape[1:] or not len(shown):
            continue
        low, high = shown.min(0), shown.max(0)
        # what never varies in the demonstrations may do so by rounding
        room = ROOM * (high - low) + 1e-3 * (1 + np.abs(shown).max(0))
        beyond = (here < low - room) | (here > high + room)
        outside |= beyond.any(1)
        counts |= {f"{key}[{dim}]": int(n) for dim, n in enumerate(beyond.sum(0)) if n}
    table = [
        [int((outside & ~success).sum()), int((~outside & ~success).sum())],
        [int((outside & success).sum()), int((~outside & success).sum())],
    ]
    p = float(fisher_exact(table, alternative="greater").pvalue)  # pyright: ignore[reportAttributeAccessIssue]
    names = sorted(counts, key=lambda name: -counts[name])[:3]
    return Outside((table[0][0], sum(table[0])), (table[1][0], sum(table[1])), p, ", ".join(names))


def out_of_range(outside: Outside | None) -> Finding:
    """Whether failing episodes start outside of the demonstrations, and others do not."""
    name = "data range"
    if outside is None:
        return Finding(name, None, "Without demonstrations their starts are not known.")
    (out, failures), (out_good, successes) = outside.failing, outside.succeeding
    told = (
        f"{out} of {failures} failing and {out_good} of {successes} succeeding episodes start outside of the "
        f"demonstrations{f' ({outside.by})' if outside.by else ''}"
    )
    if successes == 0:
        found = out > HALF * failures
        told = f"{told}; none succeeds, so that nothing can be compared"
        return Finding(name, None if found else False, f"{told}.")
    found = outside.p_value < LEVEL and outside.share > 0
    repair = "record demonstrations that start there, and train on all of them" if found else ""
    return Finding(name, found, f"{told} (Fisher p = {outside.p_value:.2g}).", repair)
