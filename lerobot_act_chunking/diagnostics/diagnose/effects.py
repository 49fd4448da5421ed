"""What an intervention does: failures that it repairs, against chance and against what it breaks.

Pure: it knows interventions by which episodes succeeded.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lerobot_act_chunking.diagnostics.core.statistics import Pairs, SuccessRate, holm
from lerobot_act_chunking.diagnostics.diagnose.trials import Trial

LEVEL = 0.05
"""Chance of naming any cause where there is none."""


@dataclass(frozen=True)
class Effect:
    """What one intervention did.

    Attributes:
        trial: the intervention.
        failing: whether episodes succeeded in which the policy as it is failed, by their seeds.
        controls: whether those did in which it succeeded.
        repetition: whether failing episodes succeeded with other noise and nothing changed; empty for a
            policy that draws none, which repeats itself.
        n_failures: failures of the policy as it is, of which ``failing`` are a sample.
        n_successes: its successes, of which ``controls`` are a sample.
    """

    trial: Trial
    failing: Mapping[int, bool]
    controls: Mapping[int, bool]
    repetition: Mapping[int, bool]
    n_failures: int
    n_successes: int

    @property
    def recovered(self) -> SuccessRate:
        """Failures that succeed now."""
        return SuccessRate(sum(self.failing.values()), len(self.failing))

    @property
    def broken(self) -> SuccessRate | None:
        """Successes that fail now; None if none was tried."""
        if not self.controls:
            return None
        return SuccessRate(sum(not each for each in self.controls.values()), len(self.controls))

    @property
    def by_chance(self) -> float:
        """Share of the failures that a mere repetition repairs."""
        common = [self.repetition[seed] for seed in self.failing if seed in self.repetition]
        return sum(common) / len(common) if common else 0.0

    @property
    def harm(self) -> float:
        """Successes that it breaks, as a share of the failures: as much is repaired by mere luck."""
        broken = self.broken
        return 0.0 if broken is None else broken.rate * self.n_successes / self.n_failures

    @property
    def net(self) -> float:
        """Share of the failures that it repairs beyond chance and harm; below 0 if it does more harm."""
        return self.recovered.rate - max(self.by_chance, self.harm)

    @property
    def p_value(self) -> float:
        """Whether chance explains the recovery: the larger one of two exact tests.

        One pairs each failing episode with its repetition (McNemar). The other compares episodes that turned
        to success with those that turned to failure: if nothing but luck had changed, as many of all
        episodes would turn either way, and their samples in the proportion of what was tried.
        """
        return max(self._p_beyond_repetition(), self._p_beyond_harm())

    def _p_beyond_repetition(self) -> float:
        seeds = list(self.failing)
        pairs = Pairs.of(
            [self.failing[each] for each in seeds], [self.repetition.get(each, False) for each in seeds]
        )
        return pairs.p_value if pairs.only_first > pairs.only_second else 1.0

    def _p_beyond_harm(self) -> float:
        from scipy.stats import binomtest

        broken = self.broken
        if broken is None:
            return 0.0
        turned = self.recovered.successes + broken.successes
        tried_failures = len(self.failing) / self.n_failures
        tried_successes = len(self.controls) / self.n_successes
        share = tried_failures / (tried_failures + tried_successes)
        if not turned or self.recovered.successes <= share * turned:
            return 1.0
        one_sided = binomtest(self.recovered.successes, turned, share, alternative="greater").pvalue
        return min(1.0, 2 * float(one_sided))


@dataclass(frozen=True)
class Ranking:
    """All interventions, the most effective first.

    Attributes:
        effects: all.
        p_values: of each, by Holm's correction over all of them.
    """

    effects: Sequence[Effect]
    p_values: Sequence[float]

    @property
    def significant(self) -> list[Effect]:
        """Those that repair something for sure."""
        return [
            effect
            for effect, p in zip(self.effects, self.p_values, strict=True)
            if p < LEVEL and effect.net > 0
        ]

    @property
    def cause(self) -> Effect | None:
        """The one that is named: of those that cannot be told from the best, the one that changes least."""
        significant = self.significant
        if not significant:
            return None
        best = significant[0]
        order = {id(effect): place for place, effect in enumerate(significant)}
        as_good = [each for each in significant if not told_apart(best, each)]
        return min(as_good, key=lambda each: (each.trial.size, order[id(each)]))

    @property
    def further(self) -> list[Effect]:
        """Other hypotheses that repair what the cause does not, the largest share first."""
        cause = self.cause
        if cause is None:
            return []
        left = [seed for seed, success in cause.failing.items() if not success]
        found, named = [], {cause.trial.hypothesis}
        for effect in self.significant:
            repaired = sum(effect.failing.get(seed, False) for seed in left)
            if effect.trial.hypothesis not in named and len(left) and repaired > len(left) / 2 >= 2:
                found.append(effect)
                named.add(effect.trial.hypothesis)
        return found


def rank(effects: Sequence[Effect]) -> Ranking:
    """The most effective first, with p-values that may be read together."""
    ordered = sorted(effects, key=lambda each: (-each.net, each.p_value, each.trial.size))
    return Ranking(ordered, holm([each.p_value for each in ordered]))


def told_apart(one: Effect, other: Effect) -> bool:
    """Whether one of two interventions repairs surely more of the same failures than the other."""
    seeds = [seed for seed in one.failing if seed in other.failing]
    if not seeds:
        return True
    return (
        Pairs.of([one.failing[each] for each in seeds], [other.failing[each] for each in seeds]).p_value
        < LEVEL
    )
