"""Which samplers, step counts and timestep spacings are swept, and what they are held against."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lerobot_act_chunking.errors import ConfigurationError, unknown_choice
from lerobot_act_chunking.sampling.process import Diffusion, Process
from lerobot_act_chunking.sampling.samplers import SAMPLERS, SPACINGS, make_sampler

STEPS = (1, 2, 3, 5, 8, 10, 16, 20, 32, 50, 100)
MOST_EVALUATIONS = 100
"""Network calls per chunk up to which a sampler is swept."""
STOCHASTIC = ("ddpm",)
_REFERENCES = {"flow": (("midpoint", 100), ("rk4", 50))}


@dataclass(frozen=True)
class Cell:
    """A sampler with its number of steps; ``spacing`` is None where the sampler has none."""

    sampler: str
    n_steps: int
    spacing: str | None = None

    def __str__(self) -> str:
        spacing = f" {self.spacing}" if self.spacing else ""
        return f"{self.sampler}{spacing} {self.n_steps}"


@dataclass(frozen=True)
class Grid:
    """What is measured.

    Attributes:
        cells: the sweep, by sampler and spacing, then by steps.
        evaluations: network calls per chunk, for the cells and the references.
        references: the many-step sampler that all are compared with, and another kind that bounds its error.
        own: the cell that the policy is configured for.
    """

    cells: tuple[Cell, ...]
    evaluations: dict[Cell, int]
    references: tuple[Cell, Cell]
    own: Cell


def make_grid(
    process: Process,
    own: Cell,
    *,
    samplers: Sequence[str] = (),
    steps: Sequence[int] = (),
) -> Grid:
    """The sweep of a policy's process.

    Args:
        process: what the policy was trained with.
        own: its configured sampler. One that draws noise at every step cannot be compared sample by sample:
            the process's first deterministic sampler stands for it.
        samplers: which to sweep; by default all that are deterministic.
        steps: step counts; by default `STEPS`. What a sampler does not allow is left out.

    Raises:
        ConfigurationError: a process without steps, or samplers or step counts that do not fit it.
    """
    available = tuple(name for name in SAMPLERS.get(process.name, ()) if name not in STOCHASTIC)
    if process.name not in ("ddpm", "flow"):
        raise ConfigurationError(
            f"objective={process.name} has a fixed number of network calls: there are no steps to sweep"
        )
    for name in samplers:
        if name in STOCHASTIC:
            raise ConfigurationError(
                f"{name} draws noise at every step, so that its samples cannot be compared one by one; "
                f"sweep {', '.join(available)}"
            )
        if name not in available:
            raise unknown_choice(f"sampler of {process.name}", name, available)
    if any(n < 1 for n in steps):
        raise ConfigurationError(f"step counts must be at least 1, got {list(steps)}")
    own = _deterministic(own, available)
    count = _counter(process)
    requested = (
        Cell(name, n, spacing)
        for name in samplers or available
        for spacing in _spacings(name)
        for n in sorted({*(steps or STEPS)})
    )
    possible = {cell: n for cell in requested if (n := count(cell)) is not None and n <= MOST_EVALUATIONS}
    references = _references(process)
    required = {cell: count(cell) for cell in (own, *references)}
    for cell, n in required.items():
        if n is None:
            raise ConfigurationError(f"{process.name} does not allow {cell} steps")
    cells = sorted({*possible, own}, key=_order)
    return Grid(tuple(cells), {**possible, **required}, references, own)  # pyright: ignore[reportArgumentType]


def _deterministic(own: Cell, available: Sequence[str]) -> Cell:
    sampler = own.sampler if own.sampler in available else available[0]
    return Cell(sampler, own.n_steps, own.spacing or _spacings(sampler)[0])


def _order(cell: Cell) -> tuple[str, str, int]:
    return cell.sampler, cell.spacing or "", cell.n_steps


def _spacings(sampler: str) -> tuple[str | None, ...]:
    return SPACINGS if sampler == "ddim" else (None,)


def _references(process: Process) -> tuple[Cell, Cell]:
    """DDIM through every noise level and DPM-Solver++; for flow two solvers of higher order."""
    if isinstance(process, Diffusion):
        levels = process.num_train_timesteps
        return Cell("ddim", levels, "leading"), Cell("dpm++", max(1, levels // 2))
    first, second = (Cell(*each) for each in _REFERENCES[process.name])
    return first, second


def _counter(process: Process) -> Callable[[Cell], int | None]:
    """Network calls of a cell; None if the sampler refuses it."""

    def count(cell: Cell) -> int | None:
        try:
            return len(make_sampler(process, cell.sampler, cell.n_steps, spacing=cell.spacing).times)
        except ConfigurationError:
            return None

    return count
