"""The answer in words: does the pretrained start help?"""

from collections.abc import Sequence

from lerobot_act_chunking.diagnostics.core.report import Judgement
from lerobot_act_chunking.diagnostics.core.statistics import holm
from lerobot_act_chunking.diagnostics.lm_ablation.effects import Effect
from lerobot_act_chunking.diagnostics.lm_ablation.matching import Match
from lerobot_act_chunking.diagnostics.lm_ablation.settings import Settings

LEVEL = 0.05
"""P-values of pretraining below it decide, after Holm's correction for all conditions."""
INCOMPLETE = (
    "the two by two is not complete: train T-R, T-LM', M-R and M-LM' with the same seeds at every size that "
    "is asked for (the same command goes on where it was)"
)


def judge(settings: Settings, match: Match, effects: Sequence[Effect], sizes: Sequence[int]) -> Judgement:
    """Whether pretraining is told apart from a random start, over all sizes.

    Args:
        settings: what was asked.
        match: of both architectures; a mismatch fails.
        effects: on success.
        sizes: demonstrations.
    """
    problems = match.problems(settings.thresholds)
    if problems:
        return Judgement("fail", problems)
    whole = sizes[0] if len(sizes) == 1 else None
    overall = {(each.name, each.condition): each for each in effects if each.size == whole or len(sizes) == 1}
    found = [overall.get(("pretraining", condition)) for condition in settings.conditions]
    known = [each for each in found if each is not None]
    if not known:
        return Judgement("inconclusive", [INCOMPLETE])
    adjusted = holm([each.p_value for each in known])
    reasons = [_said(each, p_value) for each, p_value in zip(known, adjusted, strict=True)]
    for name in ("architecture", "interaction"):
        others = [overall[name, each.condition] for each in known]
        reasons += [f"{name}, {each.condition}: {_points(each)}" for each in others if each.decided]
    return Judgement("pass" if min(adjusted) < LEVEL else "inconclusive", reasons)


def _said(found: Effect, p_value: float) -> str:
    if p_value >= LEVEL:
        return f"{found.condition}: a pretrained start is not told apart from a random one ({_points(found)})"
    way = "helps" if found.value > 0 else "harms"
    return f"{found.condition}: a pretrained start {way} ({_points(found)})"


def _points(found: Effect) -> str:
    low, high = found.interval
    return f"{100 * found.value:+.1f} points, 95 % interval {100 * low:.1f} to {100 * high:.1f}"
