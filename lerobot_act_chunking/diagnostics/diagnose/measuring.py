"""From the episodes of a policy as it is to what every intervention does with them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.diagnostics.diagnose.effects import Effect, Ranking, rank
from lerobot_act_chunking.diagnostics.diagnose.laboratory import Laboratory
from lerobot_act_chunking.diagnostics.diagnose.moments import Moments, find_moments
from lerobot_act_chunking.diagnostics.diagnose.records import Record
from lerobot_act_chunking.diagnostics.diagnose.trials import REPETITION, Trial

FEWEST_FAILURES = 10
"""Failures without which no cause can be told from chance."""
HEALTHY = 0.03
"""Share of failures below which there is nothing to explain."""
ENOUGH = 100
"""Episodes from which on that share means something."""
FIRST_LOOK = 8
"""Failures on which every intervention is tried; one that repairs none of them is given up."""
CONTROLS = 3
"""Succeeding episodes for each failing one, at most: what an intervention breaks counts as much."""
CONTENDERS = 3
"""Interventions, of as many hypotheses, that take over from later states."""


@dataclass(frozen=True)
class Measured:
    """What was done to the policy.

    Attributes:
        records: of the policy as it is.
        ranking: of all interventions; None if there were none.
        given_up: how many failures each intervention was tried on that repaired none of the first.
        repetition: failing episodes that succeed with other noise; None if the policy draws none.
        moments: when episodes are lost; None where that was not looked for.
        complete: whether there was time for all that was planned.
    """

    records: list[Record]
    ranking: Ranking | None = None
    given_up: Mapping[Trial, int] = field(default_factory=dict)
    repetition: SuccessRate | None = None
    moments: Moments | None = None
    complete: bool = True

    @property
    def failures(self) -> list[Record]:
        """Failing episodes."""
        return [each for each in self.records if not each.episode.success]

    @property
    def is_healthy(self) -> bool:
        """Whether hardly any of many episodes fails."""
        return len(self.records) >= ENOUGH and len(self.failures) < HEALTHY * len(self.records)

    @property
    def too_few(self) -> bool:
        """Whether there are too few failures to explain."""
        return len(self.failures) < FEWEST_FAILURES


def intervene(
    laboratory: Laboratory, records: list[Record], trials: Sequence[Trial], most: int, *, noisy: bool
) -> Measured:
    """Try every intervention on the failing episodes, and what it breaks on succeeding ones.

    Args:
        laboratory: runs the episodes.
        records: of the policy as it is.
        trials: the interventions.
        most: failing episodes; of succeeding ones `CONTROLS` times as many.
        noisy: whether the policy draws anything, so that a repetition comes out otherwise.
    """
    failures = [each.episode.seed for each in records if not each.episode.success]
    successes = [each.episode.seed for each in records if each.episode.success]
    failing, controls = failures[:most], successes[: CONTROLS * most]
    first, rest = failing[:FIRST_LOOK], failing[FIRST_LOOK:]
    again = laboratory.try_out({REPETITION: failing})[REPETITION] if noisy else {}
    found = laboratory.try_out(dict.fromkeys(trials, first))
    promising = [trial for trial in trials if any(found[trial].values())]
    more = laboratory.try_out(dict.fromkeys(promising, rest))
    other = laboratory.try_out(dict.fromkeys(promising, controls))
    effects = [
        Effect(
            trial=trial,
            failing=found[trial] | more.get(trial, {}),
            controls=other.get(trial, {}),
            repetition=again,
            n_failures=len(failures),
            n_successes=len(successes),
        )
        for trial in trials
        if found[trial]
    ]
    return Measured(
        records=records,
        ranking=rank(effects),
        given_up={trial: len(found[trial]) for trial in trials if trial not in promising},
        repetition=SuccessRate(sum(again.values()), len(again)) if again else None,
        complete=laboratory.complete,
    )


def search_moments(laboratory: Laboratory, measured: Measured) -> Moments | None:
    """When the episodes are lost that a sure intervention saves; None if none does."""
    contenders = _contenders(measured.ranking)
    if not contenders:
        return None
    records = {each.episode.seed: each for each in measured.failures}
    saved = sorted({seed for each in contenders for seed, success in each.failing.items() if success})
    return find_moments(laboratory, [each.trial for each in contenders], records, saved)


def _contenders(ranking: Ranking | None) -> list[Effect]:
    """The best one of each hypothesis, the named one first."""
    if ranking is None or ranking.cause is None:
        return []
    found = {ranking.cause.trial.hypothesis: ranking.cause}
    for effect in ranking.significant:
        found.setdefault(effect.trial.hypothesis, effect)
    return list(found.values())[:CONTENDERS]
