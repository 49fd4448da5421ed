"""Which candidate to use, and how sure that is."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from lerobot_act_chunking.diagnostics.core.report import Judgement
from lerobot_act_chunking.diagnostics.tune.candidates import Candidate
from lerobot_act_chunking.diagnostics.tune.racing import ALPHA, GOOD, Race
from lerobot_act_chunking.diagnostics.tune.replay import Replay

AS_GOOD = 0.95
"""Share of the leader's successes from which on a candidate with fewer network calls is preferred."""
SINGLE = 0.05
"""Level of one comparison: what falls below it does not pass for as good as the leader."""
SAME_DISTANCE = 1.02
"""Distances to the demonstrations within 2 % of the smallest count as equal."""
WEAKER = (
    "replay compares actions at the demonstrator's observations and runs no episode: a policy that stalls or "
    "drifts looks good in it, and frequent replanning looks better than it is; measure success where you can "
    "(--task, --env.type)"
)


@dataclass(frozen=True)
class TuneJudgement(Judgement):
    """The answer.

    Attributes:
        chosen: the candidate to use.
    """

    chosen: Candidate


Calls = Callable[[Candidate], float]
"""Network calls per second."""


def judge_race(race: Race[Candidate], calls: Calls) -> TuneJudgement:
    """The present settings, unless another candidate is surely better; of the better ones the cheapest.

    Args:
        race: the measurement.
        calls: of a candidate.
    """
    present = race.candidates[0]
    if race.settled:
        good = f"the present settings nearly always succeed ({race.rate(present)}): no search is worth it"
        return TuneJudgement("pass", [good], present)
    untried = [each for each in race.candidates if not race.results[each]]
    if present in untried:
        return TuneJudgement("inconclusive", [_untried(untried)], present)
    if not any(map(any, race.results.values())):
        return TuneJudgement("inconclusive", [_never(race)], present)
    leader = race.leader
    notes = [_untried(untried)] if untried else []
    if present in race.dropped or race.is_worse(present, leader):
        chosen = _cheapest(race, leader, calls)
        return TuneJudgement("warn", [_better(race, chosen, present), *notes], chosen)
    ours, best = race.both(present, leader)
    if ours < GOOD * best:
        return TuneJudgement("inconclusive", [_unsure(race, leader, present), *notes], present)
    if untried:
        return TuneJudgement("inconclusive", notes, present)
    return TuneJudgement("pass", [_as_good(race, leader, present)], present)


def judge_replay(
    candidates: Sequence[Candidate], found: Mapping[Candidate, Replay], calls: Calls
) -> TuneJudgement:
    """The candidate nearest to the demonstrations; of equals the present settings, then the least jumps.

    Args:
        candidates: all, the present settings first.
        found: of those that there was time for.
        calls: of a candidate.
    """
    present = candidates[0]
    untried = [each for each in candidates if each not in found]
    notes = [_untried(untried), WEAKER] if untried else [WEAKER]
    if present not in found:
        return TuneJudgement("inconclusive", notes, present)
    least = min(each.distance for each in found.values())
    near = [each for each in found if found[each].distance <= SAME_DISTANCE * least]
    if present in near:
        same = "no candidate comes nearer to the demonstrations than the present settings"
        return TuneJudgement("warn", [f"{same}: {_off(found, present)}", *notes], present)
    chosen = min(near, key=lambda each: (found[each].jump or 0.0, calls(each)))
    nearer = (
        f"{chosen} comes nearer to the demonstrations ({_off(found, chosen)}) than {present} "
        f"({_off(found, present)})"
    )
    return TuneJudgement("warn", [nearer, *notes], chosen)


def _off(found: Mapping[Candidate, Replay], candidate: Candidate) -> str:
    return f"off by {found[candidate].distance:.3g} standard deviations"


def _cheapest(race: Race[Candidate], leader: Candidate, calls: Calls) -> Candidate:
    """The one with fewest network calls of those that cannot be told from the leader and are close to it."""

    def as_good(candidate: Candidate) -> bool:
        ours, best = race.both(candidate, leader)
        return ours >= AS_GOOD * best and race.p_value(candidate, leader) >= SINGLE

    return min(filter(as_good, race.running), key=calls)


def _counted(race: Race[Candidate], candidate: Candidate, other: Candidate) -> str:
    ours, theirs = race.both(candidate, other)
    n = min(len(race.results[candidate]), len(race.results[other]))
    return f"{ours} of {n} episodes succeed with {candidate}, {theirs} with {other}"


def _corrected(race: Race[Candidate], candidate: Candidate, other: Candidate) -> str:
    p, comparisons = race.p_value(candidate, other), round(ALPHA / race.level)
    return f"p = {min(1.0, p * comparisons):.2g}, corrected for {comparisons} comparisons"


def _better(race: Race[Candidate], chosen: Candidate, present: Candidate) -> str:
    sure = _corrected(race, chosen, present)
    return f"there are better settings than the present ones: {_counted(race, chosen, present)} ({sure})"


def _as_good(race: Race[Candidate], leader: Candidate, present: Candidate) -> str:
    if leader == present:
        return f"no candidate did better than the present settings ({race.rate(present)})"
    return f"the present settings cannot be told from the best: {_counted(race, present, leader)}"


def _unsure(race: Race[Candidate], leader: Candidate, present: Candidate) -> str:
    return (
        f"{_counted(race, leader, present)}, which may be chance ({_corrected(race, leader, present)}): the "
        "present settings stay; run the same command with more --episodes, or again for more time"
    )


def _untried(untried: list[Candidate]) -> str:
    return (
        f"time ended before {len(untried)} candidates were tried: run the same command again, which goes on "
        "from here, or give it more --minutes or --workers"
    )


def _never(race: Race[Candidate]) -> str:
    return f"no episode of {race.n_episodes} succeeded with any candidate: there is nothing to choose by"
