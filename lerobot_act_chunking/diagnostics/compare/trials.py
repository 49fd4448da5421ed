"""What policies did, and how sure a difference between two is."""

import math
from dataclasses import dataclass
from functools import cached_property
from statistics import fmean, variance
from typing import Literal

from lerobot_act_chunking.diagnostics.core.eval_info import Episode
from lerobot_act_chunking.diagnostics.core.statistics import Pairs, SuccessRate, newcombe
from lerobot_act_chunking.errors import ConfigurationError

Kind = Literal["paired", "independent", "training seeds"]
POWER, CONFIDENCE = 0.8, 0.975  # of the smallest difference that is found; one side of 95 %
FEWEST_DIFFERING = 6  # episodes, all in favour of one: the exact test's p falls below 0.05


@dataclass(frozen=True)
class Trials:
    """The episodes of a recipe.

    Attributes:
        name: of the recipe.
        outcomes: of each training seed, whether each episode succeeded.
    """

    name: str
    outcomes: tuple[dict[Episode, bool], ...]

    @cached_property
    def rates(self) -> list[SuccessRate]:
        """Of each training seed."""
        return [SuccessRate(sum(each.values()), len(each)) for each in self.outcomes]

    @property
    def mean(self) -> float:
        """The mean of the training seeds' success rates."""
        return fmean(each.rate for each in self.rates)

    @property
    def seeds_apart(self) -> float | None:
        """Standard deviation of the rates of training seeds; None for one."""
        return math.sqrt(variance(each.rate for each in self.rates)) if len(self.rates) > 1 else None

    @property
    def episodes_apart(self) -> float:
        """What it would be if all seeds were as good, by the numbers of episodes alone."""
        return math.sqrt(fmean(_variance(each) for each in self.rates))


@dataclass(frozen=True)
class Contrast:
    """The difference between two recipes.

    Attributes:
        first: name of one.
        second: name of the other.
        kind: by the same episodes (exact McNemar, Newcombe), by others (Fisher, Newcombe), or by the rates of
            several training seeds (Welch).
        difference: success rate of the first minus that of the second.
        interval: of 95 %.
        p_value: of the two being alike.
        smallest: the difference that so many episodes or trainings would find in four of five studies; above
            1 they find none.
        pairs: the common episodes of two trainings.
    """

    first: str
    second: str
    kind: Kind
    difference: float
    interval: tuple[float, float]
    p_value: float
    smallest: float
    pairs: Pairs | None = None


def contrast(first: Trials, second: Trials, *, paired: bool) -> Contrast:
    """The difference between two recipes, both of one training or both of several.

    Raises:
        ConfigurationError: they have no episode in common, though they should.
    """
    if len(first.outcomes) > 1:
        return _of_trainings(first, second)
    return _of_pairs(first, second) if paired else _of_others(first, second)


def _of_pairs(first: Trials, second: Trials) -> Contrast:
    (one,), (other,) = first.outcomes, second.outcomes
    common = sorted(one.keys() & other.keys())
    if not common:
        raise ConfigurationError(
            f"{first.name} and {second.name} have no episode of a task in common: evaluate both with the "
            "same --env and --seed, or compare them with --unpaired"
        )
    pairs = Pairs.of([one[each] for each in common], [other[each] for each in common])
    differing = (pairs.only_first + pairs.only_second + 1) / (pairs.n + 1)
    return Contrast(
        first.name,
        second.name,
        "paired",
        pairs.difference,
        pairs.interval,
        pairs.p_value,
        max(FEWEST_DIFFERING / pairs.n, _normal_reach() * math.sqrt(differing / pairs.n)),
        pairs,
    )


def _of_others(first: Trials, second: Trials) -> Contrast:
    from scipy.stats import fisher_exact

    (one,), (other,) = first.rates, second.rates
    table = [[each.successes, each.episodes - each.successes] for each in (one, other)]
    return Contrast(
        first.name,
        second.name,
        "independent",
        one.rate - other.rate,
        newcombe(one, other),
        float(fisher_exact(table).pvalue),  # pyright: ignore[reportAttributeAccessIssue]
        _normal_reach() * math.sqrt(_variance(one) + _variance(other)),
    )


def _of_trainings(first: Trials, second: Trials) -> Contrast:
    """Welch's t-test on the rates; no seed varies less than its number of episodes makes it vary."""
    from scipy.stats import t

    parts = [
        max(each.seeds_apart or 0.0, each.episodes_apart) ** 2 / len(each.rates) for each in (first, second)
    ]
    error = math.sqrt(sum(parts))
    freedom = sum(parts) ** 2 / sum(
        part**2 / (len(each.rates) - 1) for part, each in zip(parts, (first, second), strict=True)
    )
    difference, reach = first.mean - second.mean, float(t.ppf(CONFIDENCE, freedom)) * error
    return Contrast(
        first.name,
        second.name,
        "training seeds",
        difference,
        (max(-1.0, difference - reach), min(1.0, difference + reach)),
        float(2 * t.sf(abs(difference) / error, freedom)),
        reach + float(t.ppf(POWER, freedom)) * error,
    )


def _normal_reach() -> float:
    from scipy.stats import norm

    return float(norm.ppf(CONFIDENCE) + norm.ppf(POWER))


def _variance(rate: SuccessRate) -> float:
    """Of the rate, by the number of episodes; above 0 also where all succeed (one more of each is added)."""
    share = (rate.successes + 1) / (rate.episodes + 2)
    return share * (1 - share) / rate.episodes
