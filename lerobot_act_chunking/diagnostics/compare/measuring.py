"""From the evaluations to the report."""

from collections.abc import Sequence
from itertools import combinations

from lerobot_act_chunking.diagnostics.compare.report import CompareReport
from lerobot_act_chunking.diagnostics.compare.trials import Trials, contrast
from lerobot_act_chunking.diagnostics.compare.verdict import LEVEL, judge
from lerobot_act_chunking.diagnostics.core.statistics import holm, letters

BY_ORDER = (
    "Episodes are paired by their order: that holds if all were evaluated with one --seed and the same "
    "--env. If they were not, add --unpaired."
)
ONE_TRAINING = (
    "One training each: this is about these checkpoints. Another training seed of the same recipe may differ "
    "by ten points; give several of each (NAME=first,second) to compare recipes."
)
PEEKING = (
    "The p-values hold for a number of episodes that was fixed before. If you add episodes until it is "
    "decided, go by the e-value: {least} or more{reason}."
)
OF_ALL = " (20 for each comparison of the table)"
FEWER = "{first} and {second} are compared by the {n} episodes that both have."


def measure(trials: Sequence[Trials], *, paired: bool) -> CompareReport:
    """Every policy, and every two of them.

    Args:
        trials: the policies, in any order.
        paired: whether the same episode of two began alike.

    Raises:
        ConfigurationError: two have no episode in common.
    """
    ranked = sorted(trials, key=lambda each: -each.mean)
    contrasts = [contrast(first, second, paired=paired) for first, second in combinations(ranked, 2)]
    adjusted = holm([each.p_value for each in contrasts])
    places = {each.name: place for place, each in enumerate(ranked)}
    differ = [
        (places[each.first], places[each.second])
        for each, p_value in zip(contrasts, adjusted, strict=True)
        if p_value < LEVEL
    ]
    notes = [] if contrasts[0].kind == "training seeds" else [ONE_TRAINING]
    if contrasts[0].kind == "paired":
        least, reason = round(len(contrasts) / LEVEL), OF_ALL if len(contrasts) > 1 else ""
        notes = [BY_ORDER, *notes, PEEKING.format(least=least, reason=reason)]
        sizes = {each.name: each.rates[0].episodes for each in ranked}
        notes += [
            FEWER.format(first=each.first, second=each.second, n=each.pairs.n)
            for each in contrasts
            if each.pairs is not None and each.pairs.n < max(sizes[each.first], sizes[each.second])
        ]
    return CompareReport(
        judgement=judge(ranked, contrasts, adjusted),
        trials=ranked,
        letters=letters(len(ranked), differ),
        contrasts=contrasts,
        adjusted=adjusted,
        notes=notes,
    )
