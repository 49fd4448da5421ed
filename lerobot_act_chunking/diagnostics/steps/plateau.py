"""From the sweep to numbers of steps: where each sampler's plateau is, and which one to use."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import groupby

from lerobot_act_chunking.diagnostics.steps.grid import Cell
from lerobot_act_chunking.diagnostics.steps.results import CellResult, Sweep
from lerobot_act_chunking.diagnostics.steps.statistics import observed_order

SAME_DEMONSTRATION_ERROR = 0.02
"""Relative difference between two errors against the demonstrations that counts as none."""
NO_IMPROVEMENT = 0.05
"""Relative improvement against the demonstrations, over the next two step counts, that counts as none."""
BY_FAR = 2.0
"""Spread near contact, in tolerances, from which the model and not the sampler is the limit."""
BELOW_SPREAD = 0.5
"""Error near contact, as a share of the spread there, that does not matter: it adds an eighth to it at most.
Of both, the median over observations counts."""
NOT_CONVERGED = 0.25
"""Difference between the two references, as a share of the error of 5 to 10 steps, from which there is no
convergence. From 10 steps to 100, even a first-order sampler's error falls to a tenth."""

SPREAD, CONVERGENCE = "spread", "convergence"
"""What limits a model: it samples far-apart positions, or its samples go on changing with the steps."""
PLATEAU = "plateau"
BELOW_MODEL = "below the model's own spread"
NEAREST = "as near to the demonstrations as any"


@dataclass(frozen=True)
class Series:
    """One sampler and spacing over all step counts.

    Attributes:
        order: of convergence: errors fall like ``n ** -order``; None if too few cells show it.
        plateau: fewest steps that are enough; None if none are.
        below_model: fewest steps whose error near contact does not matter beside the model's own spread.
        nearest: fewest steps that are as near to the demonstrations as any cell.
    """

    sampler: str
    spacing: str | None
    order: float | None
    plateau: int | None
    below_model: int | None
    nearest: int | None

    @property
    def name(self) -> str:
        """Sampler and, where there are several, spacing."""
        return f"{self.sampler} {self.spacing}" if self.spacing else self.sampler


@dataclass(frozen=True)
class Recommendation:
    """The sampler to use; ``reason`` is `PLATEAU` or, for a limited model, `BELOW_MODEL` or `NEAREST`."""

    cell: Cell
    evaluations: int
    reason: str

    @property
    def flags(self) -> str:
        """As LeRobot's command line wants it."""
        flags = f"--policy.sampler={self.cell.sampler} --policy.num_inference_steps={self.cell.n_steps}"
        return flags + (f" --policy.timestep_spacing={self.cell.spacing}" if self.cell.spacing else "")


def find_limit(sweep: Sweep, tolerance: float) -> str | None:
    """What no number of steps can mend, `SPREAD` or `CONVERGENCE`; None if the sampler is the limit.

    Args:
        sweep: the measurement.
        tolerance: differences that do not matter, in its unit.
    """
    floor, spread = sweep.reference.disagreement, sweep.reference.spread
    if spread is not None and spread["p50"] > BY_FAR * tolerance:
        return SPREAD
    few = [r.error["p50"] for r in sweep.cells if r.error is not None and 5 <= r.cell.n_steps <= 10]
    if floor is None or not few or floor["p95"] <= tolerance:
        return None
    return CONVERGENCE if floor["p50"] > NOT_CONVERGED * min(few) else None


def all_series(sweep: Sweep, tolerance: float) -> list[Series]:
    """Every sampler and spacing of the sweep."""
    return [_series(cells, sweep, tolerance) for cells in _by_sampler(sweep)]


def recommend(sweep: Sweep, series: list[Series], limit: str | None) -> Recommendation | None:
    """What takes the fewest network calls: of the plateaus or, for a limited model, of what suffices for it.

    With one mode that is what comes nearest to the demonstrations. With several, a blur of them would do so:
    there it is what differs less from the reference than the samples do among themselves.
    """
    if limit is None:
        reason = PLATEAU
    else:
        blurs = limit == SPREAD and sweep.reference.separation is not None
        reason = BELOW_MODEL if blurs else NEAREST
    steps_of: dict[str, Callable[[Series], int | None]] = {
        PLATEAU: lambda each: each.plateau,
        BELOW_MODEL: lambda each: each.below_model,
        NEAREST: lambda each: each.nearest,
    }
    found = [(each, steps_of[reason](each)) for each in series]
    results = [sweep.of(Cell(each.sampler, n, each.spacing)) for each, n in found if n is not None]
    if not results:
        return None
    best = min(results, key=lambda r: (r.evaluations, r.demonstration_error, str(r.cell)))
    return Recommendation(best.cell, best.evaluations, reason)


def on_plateau(sweep: Sweep, cell: Cell, tolerance: float) -> bool:
    """Whether a cell is precise, as good as the reference, and no more steps of its sampler are better."""
    same_sampler = [
        r for r in sweep.cells if (r.cell.sampler, r.cell.spacing) == (cell.sampler, cell.spacing)
    ]
    here = sweep.of(cell)
    reference, later = sweep.reference.demonstration_error, same_sampler[same_sampler.index(here) + 1 :][:2]
    improved = [here.demonstration_error - result.demonstration_error for result in later]
    return (
        here.error is not None
        and here.error["p95"] < tolerance
        and abs(here.demonstration_error - reference) < SAME_DEMONSTRATION_ERROR * reference
        and all(gain < NO_IMPROVEMENT * here.demonstration_error for gain in improved)
    )


def _by_sampler(sweep: Sweep) -> Iterator[list[CellResult]]:
    for _, cells in groupby(sweep.cells, lambda result: (result.cell.sampler, result.cell.spacing)):
        yield list(cells)


def _series(cells: list[CellResult], sweep: Sweep, tolerance: float) -> Series:
    floor, spread = sweep.reference.disagreement, sweep.reference.spread
    errors = [(r.cell.n_steps, r.error) for r in cells if r.error is not None]
    touching = [(r.cell.n_steps, r.error_near_contact) for r in cells if r.error_near_contact is not None]
    nearest = min(result.demonstration_error for result in sweep.cells)
    enough = (r.cell.n_steps for r in cells if on_plateau(sweep, r.cell, tolerance))
    small = (n for n, error in touching if spread and error["p50"] < BELOW_SPREAD * spread["p50"])
    near = (
        r.cell.n_steps for r in cells if r.demonstration_error <= (1 + SAME_DEMONSTRATION_ERROR) * nearest
    )
    return Series(
        sampler=cells[0].cell.sampler,
        spacing=cells[0].cell.spacing,
        order=observed_order(
            [n for n, _ in errors], [error["p50"] for _, error in errors], floor["p50"] if floor else 0.0
        ),
        plateau=next(enough, None),
        below_model=next(small, None),
        nearest=next(near, None),
    )
