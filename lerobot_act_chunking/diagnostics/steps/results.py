"""What the sweep found, as plain numbers."""

from dataclasses import dataclass

from lerobot_act_chunking.diagnostics.steps.grid import Cell

Quantiles = dict[str, float] | None


@dataclass(frozen=True)
class CellResult:
    """What one sampler does with one number of steps. Errors are in the measure's unit.

    Attributes:
        evaluations: network calls per chunk.
        ms: time per chunk at batch size 1.
        error: of a chunk against the reference from the same noise: its largest over the executed steps.
        error_near_contact: the same over steps near contact ...
        error_elsewhere: ... and over the others.
        error_by_point: 95th percentile for each point of the measure.
        flip_rate: share of pairs that ended in different modes; they are no part of the errors.
        demonstration_error: mean distance to the demonstrated actions.
        energy: energy distance to the reference's samples, mean over observations.
        energy_share: the same as a share of the largest possible, 0 to 1.
        rarest_mode: mean mass of each observation's rarest mode, among those with several.
        spread: spread over noises near contact, within a mode; median over observations.
    """

    cell: Cell
    evaluations: int
    ms: float | None
    error: Quantiles
    error_near_contact: Quantiles
    error_elsewhere: Quantiles
    error_by_point: dict[str, float] | None
    flip_rate: float
    demonstration_error: float
    energy: float | None = None
    energy_share: float | None = None
    rarest_mode: float | None = None
    spread: float | None = None


@dataclass(frozen=True)
class Reference:
    """The many-step sampler, and what the model itself is worth.

    Attributes:
        disagreement: paired error of the second reference, which bounds the reference's own.
        spread: over noises near contact, within a mode, over observations [unit of the measure].
        spread_of_all: the same without regard to modes.
        demonstration_error: mean distance to the demonstrated actions ...
        demonstration_error_near_contact: ... and near contact, quantiles over observations.
        mode_counts: number of observations with 1, 2, ... modes.
        separation: smallest distance between two modes; None if there is one.
        rarest_mode: mean mass of each observation's rarest mode, among those with several.
    """

    cell: Cell
    second: Cell
    disagreement: Quantiles
    spread: Quantiles
    spread_of_all: Quantiles
    demonstration_error: float
    demonstration_error_near_contact: Quantiles
    mode_counts: list[int]
    separation: float | None
    rarest_mode: float | None


@dataclass(frozen=True)
class Sweep:
    """All cells and their reference."""

    cells: list[CellResult]
    reference: Reference
    n_observations: int
    n_near_contact: int

    def of(self, cell: Cell) -> CellResult:
        """The result of one cell."""
        return next(result for result in self.cells if result.cell == cell)
