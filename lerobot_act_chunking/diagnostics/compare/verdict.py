"""The answer in words: is one surely better than the others?"""

import math
from collections.abc import Sequence

from lerobot_act_chunking.diagnostics.compare.trials import Contrast, Trials
from lerobot_act_chunking.diagnostics.core.report import Judgement

LEVEL = 0.05
"""P-values below it decide, after Holm's correction for all comparisons."""


def judge(ranked: Sequence[Trials], contrasts: Sequence[Contrast], adjusted: Sequence[float]) -> Judgement:
    """Whether the first one surely succeeds more often than every other.

    Args:
        ranked: the policies, the best first.
        contrasts: of every two of them, the better one first.
        adjusted: their p-values after Holm's correction.
    """
    best = ranked[0].name
    of_best = [
        (each, p_value) for each, p_value in zip(contrasts, adjusted, strict=True) if each.first == best
    ]
    decided = [_decided(each, p_value) for each, p_value in of_best if p_value < LEVEL]
    undecided = [_undecided(each, ranked) for each, p_value in of_best if p_value >= LEVEL]
    return Judgement("inconclusive" if undecided else "pass", [*undecided, *decided])


def _decided(found: Contrast, p_value: float) -> str:
    low, high = found.interval
    return (
        f"{found.first} succeeds more often than {found.second}: by {100 * found.difference:.1f} points "
        f"(95 % interval {100 * low:.1f} to {100 * high:.1f}, p = {p_value:.2g})"
    )


def _undecided(found: Contrast, ranked: Sequence[Trials]) -> str:
    first, second = (
        next(each for each in ranked if each.name == name) for name in (found.first, found.second)
    )
    rates = f"{first.name} ({100 * first.mean:.1f} %) and {second.name} ({100 * second.mean:.1f} %)"
    shows = f"show differences of about {100 * found.smallest:.0f} points"
    if found.smallest > 1:
        shows = "are too few to show any difference"
    if found.kind == "training seeds":
        seeds = f"{len(first.rates)} and {len(second.rates)} training seeds"
        return f"{rates} are not told apart: {seeds} {shows}"
    episodes = found.pairs.n if found.pairs else min(first.rates[0].episodes, second.rates[0].episodes)
    text = f"{rates} are not told apart: {episodes} episodes {shows}"
    if not found.difference:
        return text
    needed = episodes * (found.smallest / found.difference) ** 2
    return f"{text}; if this one is real, about {_rounded_up(needed)} would show it"


def _rounded_up(episodes: float) -> int:
    """To two digits."""
    unit = 10 ** max(0, math.floor(math.log10(episodes)) - 1)
    return math.ceil(episodes / unit) * unit
