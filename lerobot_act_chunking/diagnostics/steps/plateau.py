"""From the sweep to an answer: how many steps are enough, or why no number of steps would be."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

from lerobot_act_chunking.diagnostics.steps.grid import Cell
from lerobot_act_chunking.diagnostics.steps.results import CellResult, Sweep
from lerobot_act_chunking.diagnostics.steps.statistics import observed_order

SAME_DEMONSTRATION_ERROR = 0.02
"""Relative difference to the reference's error against the demonstrations that counts as none."""
NO_IMPROVEMENT = 0.05
"""Relative improvement against the demonstrations, over the next two step counts, that counts as none."""
BY_FAR = 2.0
"""Spread near contact, in tolerances, from which the model and not the sampler is the limit."""
BELOW_SPREAD = 0.5
"""Error, as a share of the spread, that does not matter beside it: it adds at most an eighth to it."""
FEWEST_OBSERVATIONS = 256

PLATEAU, BELOW_MODEL = "plateau", "below the model's own spread"


@dataclass(frozen=True)
class Series:
    """One sampler and spacing over all step counts.

    Attributes:
        order: of convergence: errors fall like ``n ** -order``; None if too few cells show it.
        plateau: fewest steps that are enough; None if none are.
        below_model: fewest steps whose error does not matter beside the model's own spread.
    """

    sampler: str
    spacing: str | None
    order: float | None
    plateau: int | None
    below_model: int | None


@dataclass(frozen=True)
class Recommendation:
    """The sampler to use; ``reason`` is `PLATEAU` or, for a limited model, `BELOW_MODEL`."""

    cell: Cell
    evaluations: int
    reason: str

    @property
    def flags(self) -> str:
        """As LeRobot's command line wants it."""
        flags = f"--policy.sampler={self.cell.sampler} --policy.num_inference_steps={self.cell.n_steps}"
        return flags + (f" --policy.timestep_spacing={self.cell.spacing}" if self.cell.spacing else "")


@dataclass(frozen=True)
class Judgement:
    """The answer."""

    verdict: str
    reasons: list[str]
    series: list[Series]
    recommended: Recommendation | None
    model_limited: bool


def judge(sweep: Sweep, own: Cell, tolerance: float, unit: str) -> Judgement:
    """Find each sampler's plateau and say whether the policy's own steps are on it.

    Args:
        sweep: the measurement.
        own: the sampler that the policy uses.
        tolerance: differences that do not matter, in the sweep's unit.
        unit: its name.
    """
    spread = sweep.reference.spread
    limited = spread is not None and spread["p50"] > BY_FAR * tolerance
    series = [_series(list(cells), sweep, tolerance) for cells in _by_sampler(sweep)]
    recommended = _recommend(sweep, series, limited)
    verdict, reasons = _verdict(sweep, own, tolerance, unit, limited)
    if recommended is not None and verdict != "inconclusive":
        reasons += _advice(sweep.of(own), recommended)
    return Judgement(verdict, reasons, series, recommended, limited)


def _by_sampler(sweep: Sweep) -> Iterator[list[CellResult]]:
    for _, cells in groupby(sweep.cells, lambda result: (result.cell.sampler, result.cell.spacing)):
        yield list(cells)


def _series(cells: list[CellResult], sweep: Sweep, tolerance: float) -> Series:
    floor = sweep.reference.disagreement
    measured = [result for result in cells if result.error is not None]
    own_floor = 0.0 if floor is None else floor["p50"]
    enough = (i for i in range(len(cells)) if _on_plateau(cells, i, sweep, tolerance))
    spread = sweep.reference.spread
    small = (r for r in measured if spread and r.error and r.error["p95"] < BELOW_SPREAD * spread["p50"])
    plateau, below = next(enough, None), next(small, None)
    return Series(
        sampler=cells[0].cell.sampler,
        spacing=cells[0].cell.spacing,
        order=observed_order(
            [r.cell.n_steps for r in measured], [r.error["p50"] for r in measured if r.error], own_floor
        ),
        plateau=None if plateau is None else cells[plateau].cell.n_steps,
        below_model=None if below is None else below.cell.n_steps,
    )


def _on_plateau(cells: list[CellResult], i: int, sweep: Sweep, tolerance: float) -> bool:
    """Precise, as good as the reference against the demonstrations, and no better with more steps."""
    here, reference = cells[i], sweep.reference.demonstration_error
    improved = [here.demonstration_error - later.demonstration_error for later in cells[i + 1 : i + 3]]
    return (
        here.error is not None
        and here.error["p95"] < tolerance
        and abs(here.demonstration_error - reference) < SAME_DEMONSTRATION_ERROR * reference
        and all(gain < NO_IMPROVEMENT * here.demonstration_error for gain in improved)
    )


def _recommend(sweep: Sweep, series: list[Series], limited: bool) -> Recommendation | None:
    """The plateau, or for a limited model what suffices for it, that takes the fewest network calls."""
    candidates = []
    for each in series:
        steps = each.below_model if limited else each.plateau
        if steps is not None:
            result = sweep.of(Cell(each.sampler, steps, each.spacing))
            assert result.error is not None  # noqa: S101  (both rules ask for its quantiles)
            candidates.append((result.evaluations, result.error["p95"], str(result.cell), result.cell))
    if not candidates:
        return None
    evaluations, _, _, cell = min(candidates, key=lambda each: each[:3])
    return Recommendation(cell, evaluations, BELOW_MODEL if limited else PLATEAU)


def _verdict(sweep: Sweep, own: Cell, tolerance: float, unit: str, limited: bool) -> tuple[str, list[str]]:
    floor, spread, reference = sweep.reference.disagreement, sweep.reference.spread, sweep.reference.cell
    if limited and spread is not None:
        return "fail", [
            f"model-limited: near contact, samples for one observation spread by {spread['p50']:.2g} {unit} "
            f"even with {reference} (allowed: {tolerance:g} {unit}): no number of steps mends that"
        ]
    if floor is None or floor["p95"] > tolerance:
        apart = "everywhere" if floor is None else f"by {floor['p95']:.2g} {unit}"
        return "inconclusive", [
            f"the two many-step references, {reference} and {sweep.reference.second}, differ {apart}, more "
            f"than the tolerance of {tolerance:g} {unit}: neither can judge the others"
        ]
    if sweep.n_observations < FEWEST_OBSERVATIONS:
        return "inconclusive", [
            f"{sweep.n_observations} observations are too few for a 95th percentile; it takes "
            f"{FEWEST_OBSERVATIONS}: hold out more --episodes"
        ]
    return _verdict_on(sweep, own, tolerance, unit)


def _verdict_on(sweep: Sweep, own: Cell, tolerance: float, unit: str) -> tuple[str, list[str]]:
    """Of the policy's own steps, by a reference and a model that are precise enough."""
    mine, reference = sweep.of(own), sweep.reference
    if mine.error is None or mine.error["p95"] >= tolerance:
        apart = "all in another mode" if mine.error is None else f"{mine.error['p95']:.2g} {unit} (p95) off"
        return "fail", [f"too few steps: {own} is {apart}, held against {reference.cell}"]
    enough = f"{own} is within {mine.error['p95']:.2g} {unit} (p95) of {reference.cell}"
    kin = [r for r in sweep.cells if (r.cell.sampler, r.cell.spacing) == (own.sampler, own.spacing)]
    if not _on_plateau(kin, kin.index(mine), sweep, tolerance):
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


def _unexplained(sweep: Sweep, tolerance: float) -> float | None:
    """Distance to the demonstrations near contact, if neither tolerance nor spread account for it."""
    apart, spread = sweep.reference.demonstration_error_near_contact, sweep.reference.spread
    if apart is None or spread is None or apart["p50"] <= BY_FAR * max(tolerance, spread["p50"]):
        return None
    return apart["p50"]


def _advice(own: CellResult, recommended: Recommendation) -> list[str]:
    if recommended.cell == own.cell:
        return [f"{own.cell} is the cheapest that is enough"]
    what = "is all that this model can use" if recommended.reason == BELOW_MODEL else "is enough"
    calls = f"{recommended.evaluations} network calls a chunk, now {own.evaluations}"
    return [f"{recommended.cell} {what}: {calls}"]
