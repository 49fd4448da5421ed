"""Why the policy fails, how sure that is, and what to change."""

from collections.abc import Sequence
from dataclasses import dataclass

from lerobot_act_chunking.diagnostics.core.report import Judgement
from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.diagnostics.diagnose.causes import Finding
from lerobot_act_chunking.diagnostics.diagnose.effects import Effect
from lerobot_act_chunking.diagnostics.diagnose.looking import Seen
from lerobot_act_chunking.diagnostics.diagnose.measuring import FEWEST_FAILURES, Measured
from lerobot_act_chunking.diagnostics.diagnose.trials import MEANINGS

MOST_OF_THEM = 0.75
"""Share of the failures that an intervention has to repair, or under-training is named before it."""
BY_CHANCE = 0.5
"""Share of the failures that other noise alone repairs, if they are a matter of the draw."""
STATISTICS = ("inert statistics", "wrong statistics")
WITHOUT = (
    "without an environment no episode is seen to fail and nothing can be changed: whether chunks are used "
    "for too long, too short, blended too much or drawn from wrong modes needs --env.type"
)


@dataclass(frozen=True)
class Cause:
    """A cause that is named.

    Attributes:
        name: of the hypothesis.
        evidence: in one sentence.
        repair: options or a command, or what to do.
        effect: of the intervention that shows it; None for one that is seen.
    """

    name: str
    evidence: str
    repair: str
    effect: Effect | None = None


@dataclass(frozen=True)
class DiagnoseJudgement(Judgement):
    """The answer.

    Attributes:
        causes: those that are named, the one that explains most first.
    """

    causes: list[Cause]


def judge(measured: Measured | None, seen: Seen) -> DiagnoseJudgement:
    """Name the causes.

    Args:
        measured: what was done in the environment; None without one.
        seen: what could be seen.
    """
    certain = [each for each in seen.findings if each.found and each.certain]
    if measured is None:
        return _by_sight(certain, seen)
    if not measured.records:
        return _open("time ended before the first episodes: give more --minutes or --workers, or run again")
    rate = SuccessRate(len(measured.failures), len(measured.records))
    told = f"{rate.successes} of {rate.episodes} episodes fail"
    if measured.is_healthy:
        return DiagnoseJudgement("pass", [f"healthy: {told}"], [])
    if measured.too_few:
        n = len(measured.failures)
        return _open(
            f"{n} failures are too few: run more --episodes ({FEWEST_FAILURES} tell causes from chance)"
        )
    causes = _causes(measured, seen, certain)
    if causes:
        return DiagnoseJudgement("fail", [f"{told}: {_named(causes)}"], causes)
    return _open(f"{told}, and none of these causes explains it{_unfinished(measured)}")


def _by_sight(certain: Sequence[Finding], seen: Seen) -> DiagnoseJudgement:
    found = [*certain, *(each for each in seen.findings if each.found and not each.certain and each.repair)]
    causes = [_seen(each) for each in found]
    if causes:
        return DiagnoseJudgement("fail", [_named(causes), WITHOUT], causes)
    return _open(f"nothing that a dataset shows is wrong; {WITHOUT}")


def _causes(measured: Measured, seen: Seen, certain: Sequence[Finding]) -> list[Cause]:
    """In the order of what they explain."""
    effect = measured.ranking.cause if measured.ranking else None
    if certain:
        return [_with_effect(each, measured) for each in certain]
    found: list[tuple[float, Cause]] = []
    if effect is not None:
        found.append((effect.net, _shown(effect)))
    range_ = _finding(seen, "data range")
    if range_ is not None and seen.outside is not None:
        found.append((seen.outside.share, _seen(range_)))
    weak, drawn = _finding(seen, "under-training or too little data"), measured.repetition
    by_draw = drawn is not None and not found and drawn.rate >= (MOST_OF_THEM if weak else BY_CHANCE)
    if by_draw and drawn is not None:
        found.append((drawn.rate, _drawn(drawn, measured)))
    if weak is not None and all(share < MOST_OF_THEM for share, _ in found):
        found.append((MOST_OF_THEM, _seen(weak)))
    ordered = [cause for _, cause in sorted(found, key=lambda each: -each[0])]
    return ordered + [_shown(each) for each in (measured.ranking.further if measured.ranking else ())]


def _drawn(repetition: SuccessRate, measured: Measured) -> Cause:
    """The draw decides; with the way of drawing that is no worse than drawing again, if there is one."""
    low, high = (100 * end for end in repetition.exact_interval)
    told = (
        f"what is drawn decides: with other noise and nothing changed {repetition.successes} of "
        f"{repetition.episodes} failing episodes succeed ({low:.0f} to {high:.0f} %)."
    )
    effects = measured.ranking.effects if measured.ranking else ()
    better = [each for each in effects if each.trial.hypothesis == "wrong mode" and each.net > 0]
    if better:  # the most effective first
        return Cause("wrong mode", f"{told} {_told(better[0])}", better[0].trial.repair, better[0])
    return Cause(
        "wrong mode",
        told,
        "leave out demonstrations of the way that fails (act-chunking data), or train for longer",
    )


def _finding(seen: Seen, name: str) -> Finding | None:
    return next((each for each in seen.findings if each.name == name and each.found), None)


def _seen(finding: Finding) -> Cause:
    return Cause(finding.name, finding.evidence, finding.repair)


def _with_effect(finding: Finding, measured: Measured) -> Cause:
    """What is seen, with what its repair does, where that was tried."""
    effects = measured.ranking.significant if measured.ranking else []
    for effect in effects:
        if finding.name in STATISTICS and effect.trial.hypothesis == "wrong statistics":
            return Cause(finding.name, f"{finding.evidence} {_told(effect)}", finding.repair, effect)
    return _seen(finding)


def _shown(effect: Effect) -> Cause:
    trial = effect.trial
    return Cause(trial.hypothesis, f"{MEANINGS[trial.hypothesis]}. {_told(effect)}", trial.repair, effect)


def _told(effect: Effect) -> str:
    recovered, broken = effect.recovered, effect.broken
    low, high = (100 * end for end in recovered.exact_interval)
    text = (
        f"With {effect.trial.change}, {recovered.successes} of {recovered.episodes} failing episodes succeed "
        f"({low:.0f} to {high:.0f} %)"
    )
    if effect.repetition:
        text += f", by repetition {100 * effect.by_chance:.0f} %"
    if broken is not None:
        text += f", and {broken.successes} of {broken.episodes} succeeding ones fail"
    return f"{text}."


def _named(causes: Sequence[Cause]) -> str:
    first, *others = causes
    text = f"{first.name}: {first.evidence}"
    return text + "".join(f" Also {each.name}: {each.evidence}" for each in others)


def _unfinished(measured: Measured) -> str:
    if measured.complete:
        return ""
    return "; time ended before all was tried: run the same command again, which goes on from here"


def _open(reason: str) -> DiagnoseJudgement:
    return DiagnoseJudgement("inconclusive", [reason], [])
