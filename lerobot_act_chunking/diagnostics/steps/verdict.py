"""The answer in words: are the policy's steps enough, and if not, would more help?"""

from dataclasses import dataclass

from lerobot_act_chunking.diagnostics.core.report import Judgement
from lerobot_act_chunking.diagnostics.steps.grid import Cell
from lerobot_act_chunking.diagnostics.steps.plateau import (
    BY_FAR,
    PLATEAU,
    SPREAD,
    Recommendation,
    Series,
    all_series,
    find_limit,
    on_plateau,
    recommend,
)
from lerobot_act_chunking.diagnostics.steps.results import CellResult, Sweep

FEWEST_OBSERVATIONS = 256
Verdict = tuple[str, list[str]]


@dataclass(frozen=True)
class StepsJudgement(Judgement):
    """The answer.

    Attributes:
        series: every sampler over all step counts.
        recommended: the sampler to use, if any is enough; None where the verdict is inconclusive.
        limit: what no number of steps can mend, `plateau.SPREAD` or `plateau.CONVERGENCE`; None for nothing.
    """

    series: list[Series]
    recommended: Recommendation | None
    limit: str | None


def judge(sweep: Sweep, own: Cell, tolerance: float, unit: str) -> StepsJudgement:
    """Find each sampler's plateau and say whether the policy's own steps are on it.

    Args:
        sweep: the measurement.
        own: the sampler that the policy uses.
        tolerance: differences that do not matter, in the sweep's unit.
        unit: its name.
    """
    limit = find_limit(sweep, tolerance)
    series = all_series(sweep, tolerance)
    if sweep.n_observations < FEWEST_OBSERVATIONS:
        verdict, reasons = _too_few(sweep)
    elif limit is not None:
        verdict, reasons = _limited(sweep, limit, tolerance, unit)
    else:
        verdict, reasons = _by_the_reference(sweep, own, tolerance, unit)
    recommended = None if verdict == "inconclusive" else recommend(sweep, series, limit)
    if recommended is not None:
        reasons += _advice(sweep.of(own), recommended)
    return StepsJudgement(verdict, reasons, series, recommended, limit)


def _too_few(sweep: Sweep) -> Verdict:
    return "inconclusive", [
        f"{sweep.n_observations} observations are too few for a 95th percentile; it takes "
        f"{FEWEST_OBSERVATIONS}: hold out more --episodes"
    ]


def _limited(sweep: Sweep, limit: str, tolerance: float, unit: str) -> Verdict:
    reference = sweep.reference
    if limit == SPREAD and reference.spread is not None:
        found = (
            f"near contact, samples for one observation spread by {reference.spread['p50']:.2g} {unit} "
            f"even with {reference.cell}"
        )
    else:
        found = (
            f"more steps do not converge: even {reference.second} and {reference.cell} differ by "
            f"{_p95(reference.disagreement)} {unit} (95 %)"
        )
    return "fail", [f"model-limited: {found} (allowed: {tolerance:g} {unit}); no number of steps mends that"]


def _by_the_reference(sweep: Sweep, own: Cell, tolerance: float, unit: str) -> Verdict:
    """For a model that is precise enough to tell samplers apart."""
    mine, reference = sweep.of(own), sweep.reference
    if reference.disagreement is None or reference.disagreement["p95"] > tolerance:
        return "inconclusive", [
            f"the two many-step references, {reference.cell} and {reference.second}, differ by "
            f"{_p95(reference.disagreement)} {unit} (95 %), more than {tolerance:g} {unit}: neither can "
            "judge the others"
        ]
    if mine.error is None or mine.error["p95"] >= tolerance:
        return "fail", [f"too few steps: {own} is {_p95(mine.error)} {unit} (95 %) off {reference.cell}"]
    enough = f"{own} is within {_p95(mine.error)} {unit} (95 %) of {reference.cell}"
    if not on_plateau(sweep, own, tolerance):
        return "warn", [
            f"{enough}, but its distance to the demonstrations ({mine.demonstration_error:.3g} {unit}) is "
            f"not the same yet ({reference.demonstration_error:.3g} {unit}), or more steps still lower it"
        ]
    apart = _unexplained(sweep, tolerance)
    if apart is not None:
        return "warn", [
            f"{enough}, but near contact both are {apart:.2g} {unit} away from the demonstrations, more than "
            "the spread of the samples explains: steps do not help against that"
        ]
    return "pass", [enough]


def _p95(errors: dict[str, float] | None) -> str:
    return "another mode, not" if errors is None else f"{errors['p95']:.2g}"


def _unexplained(sweep: Sweep, tolerance: float) -> float | None:
    """Distance to the demonstrations near contact, if neither tolerance nor spread account for it."""
    apart, spread = sweep.reference.demonstration_error_near_contact, sweep.reference.spread
    if apart is None or spread is None or apart["p50"] <= BY_FAR * max(tolerance, spread["p50"]):
        return None
    return apart["p50"]


def _advice(own: CellResult, recommended: Recommendation) -> list[str]:
    if recommended.cell == own.cell:
        return [f"{own.cell} is the cheapest that is enough for it"]
    what = "is enough" if recommended.reason == PLATEAU else f"is {recommended.reason}"
    calls = f"{recommended.evaluations} network calls a chunk, now {own.evaluations}"
    return [f"{recommended.cell} {what}: {calls}"]
