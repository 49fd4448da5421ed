"""The measurement: the same noises through every sampler and step count, held against many steps."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from lerobot_act_chunking.diagnostics.core.episodes import evenly
from lerobot_act_chunking.diagnostics.core.measures import Measure, distances
from lerobot_act_chunking.diagnostics.steps.grid import Cell, Grid
from lerobot_act_chunking.diagnostics.steps.modes import Modes, find_all_modes
from lerobot_act_chunking.diagnostics.steps.results import CellResult, Reference, Sweep
from lerobot_act_chunking.diagnostics.steps.statistics import (
    chunk_error,
    energy_distance,
    quantiles,
    spread,
)

DISTRIBUTION_STEPS = 20
"""Step counts up to which whole distributions are compared, not only pairs."""
FLIPPED = 0.75
"""Share of the distance between two modes from which a pair is in two modes; a blur of both is half-way."""


class Subject(Protocol):
    """A policy with held-out observations."""

    @property
    def noise_shape(self) -> tuple[int, int]:
        """Of the noise of one chunk, (horizon, A)."""
        ...

    def sample(self, cell: Cell, rows: np.ndarray, noise: Tensor) -> np.ndarray:
        """Executed actions (N, b, T, A), raw, for observations ``rows`` (b,) from noise (N, b, H, A)."""
        ...

    def milliseconds(self, cell: Cell) -> float | None:
        """Wall-clock time for one chunk of one observation; None if it is not measured."""
        ...


@dataclass(frozen=True)
class Demonstrated:
    """What was done at the held-out observations.

    Attributes:
        actions: (M, T, A) in raw units.
        near_contact: (M, T), the steps close to contact; see `sources.near_contact`.
    """

    actions: np.ndarray
    near_contact: np.ndarray


@dataclass(frozen=True)
class Scale:
    """How much is measured.

    Attributes:
        distributions: observations, of those held out, that get many samples: a distribution of chunks each.
        noises: samples for each of these.
        tolerance: differences that do not matter, in the measure's unit.
        seed: of the noise.
    """

    distributions: int = 32
    noises: int = 16
    tolerance: float = 0.5
    seed: int = 0


Progress = Callable[[int, int], None]


def run_sweep(
    subject: Subject,
    grid: Grid,
    demonstrated: Demonstrated,
    measure: Measure,
    scale: Scale,
    progress: Progress | None = None,
) -> Sweep:
    """Sample every cell from the same noises and compare.

    Args:
        subject: the policy.
        grid: its cells.
        demonstrated: what was done at the observations.
        measure: what actions mean in space.
        scale: how much.
        progress: called with network evaluations (of one chunk) done and planned.
    """
    return _Run(subject, grid, demonstrated, measure, scale, progress).sweep()


class _Run:
    """One sweep under way: noises, reference samples, and how far it is."""

    def __init__(
        self,
        subject: Subject,
        grid: Grid,
        demonstrated: Demonstrated,
        measure: Measure,
        scale: Scale,
        progress: Progress | None,
    ) -> None:
        self.subject, self.grid, self.measure, self.scale = subject, grid, measure, scale
        self.near = demonstrated.near_contact
        self.demonstrated = measure.points(demonstrated.actions)
        self.rows = np.arange(len(self.near))
        self.distribution_rows = _choose_rows(self.near, scale.distributions)
        generator = torch.Generator().manual_seed(scale.seed)
        self.noise = torch.randn(1, len(self.rows), *subject.noise_shape, generator=generator)
        self.distribution_noise = torch.randn(
            scale.noises, len(self.distribution_rows), *subject.noise_shape, generator=generator
        )
        self.progress, self.done = progress, 0
        first, second = grid.references
        others = [cell for cell in grid.cells if cell != first]
        self.planned = sum(
            self._cost(cell, distribution=self._compares_distributions(cell)) for cell in others
        )
        self.planned += self._cost(first, distribution=True) + self._cost(second, distribution=False)

    def sweep(self) -> Sweep:
        first, second = self.grid.references
        self.reference = self._pairs(first)
        self.modes = find_all_modes(self._distribution_samples(first), self.scale.tolerance)
        several = [modes for modes in self.modes if modes.count > 1]
        self.separation = min((modes.separation for modes in several), default=np.inf)
        reference = self._reference(self._pairs(second), several)
        return Sweep(
            cells=[self._cell(cell) for cell in self.grid.cells],
            reference=reference,
            n_observations=len(self.rows),
            n_near_contact=int(self.near.any(1).sum()),
        )

    def _reference(self, second: np.ndarray, several: list[Modes]) -> Reference:
        to_demonstrations = distances(self.reference, self.demonstrated)
        apart = distances(second, self.reference)
        counts = np.bincount([modes.count for modes in self.modes])[1:]
        return Reference(
            cell=self.grid.references[0],
            second=self.grid.references[1],
            disagreement=quantiles(self._without_flips(chunk_error(apart))),
            spread=quantiles(self._spreads([modes.samples for modes in self.modes])),
            spread_of_all=quantiles(self._spreads([modes.samples for modes in self.modes], by_mode=False)),
            demonstration_error=float(to_demonstrations.mean()),
            demonstration_error_near_contact=quantiles(_mean_at(to_demonstrations, self.near)),
            mode_counts=counts.tolist(),
            separation=None if not several else float(self.separation),
            rarest_mode=float(np.mean([modes.masses().min() for modes in several])) if several else None,
        )

    def _cell(self, cell: Cell) -> CellResult:
        points = self.reference if cell == self.grid.references[0] else self._pairs(cell)
        by_point = np.linalg.norm(points - self.reference, axis=-1)  # (M, T, P)
        errors = by_point.max(-1)
        flipped = chunk_error(errors) > FLIPPED * self.separation
        kept = np.where(flipped[:, None], np.nan, errors)
        return CellResult(
            cell=cell,
            evaluations=self.grid.evaluations[cell],
            ms=self.subject.milliseconds(cell),
            error=quantiles(chunk_error(kept)),
            error_near_contact=quantiles(chunk_error(kept, self.near)),
            error_elsewhere=quantiles(chunk_error(kept, ~self.near)),
            error_by_point=self._by_point(by_point[~flipped]),
            flip_rate=float(flipped.mean()),
            demonstration_error=float(distances(points, self.demonstrated).mean()),
            **self._distribution(cell),
        )

    def _by_point(self, errors: np.ndarray) -> dict[str, float] | None:
        if not len(errors):
            return None
        worst = np.percentile(errors.max(1), 95, axis=0)
        return dict(zip(self.measure.names, worst.tolist(), strict=True))

    def _distribution(self, cell: Cell) -> dict[str, Any]:
        if not self._compares_distributions(cell):
            return {}
        is_reference = cell == self.grid.references[0]
        samples = (
            [modes.samples for modes in self.modes] if is_reference else self._distribution_samples(cell)
        )
        pairs = list(zip(samples, self.modes, strict=True))
        energies, largest = zip(*(energy_distance(each, modes.samples) for each, modes in pairs), strict=True)
        masses = [modes.masses(each)[-1] for each, modes in pairs if modes.count > 1]
        near = quantiles(self._spreads(samples))
        return {
            "energy": float(np.mean(energies)),
            "energy_share": float(max(0.0, sum(energies)) / max(sum(largest), 1e-12)),
            "rarest_mode": float(np.mean(masses)) if masses else None,
            "spread": near and near["p50"],
        }

    def _spreads(self, samples: list[np.ndarray], *, by_mode: bool = True) -> np.ndarray:
        """RMS spread near contact of each observation with many samples; NaN for those away from it."""
        pairs = zip(samples, self.modes, strict=True)
        labels = [modes.assign(each) if by_mode else None for each, modes in pairs]
        spreads = np.stack([spread(each, of) for each, of in zip(samples, labels, strict=True)])
        return np.sqrt(_mean_at(spreads**2, self.near[self.distribution_rows]))

    def _without_flips(self, errors: np.ndarray) -> np.ndarray:
        return np.where(errors > FLIPPED * self.separation, np.nan, errors)

    def _compares_distributions(self, cell: Cell) -> bool:
        return cell.n_steps <= DISTRIBUTION_STEPS or cell in (self.grid.own, self.grid.references[0])

    def _pairs(self, cell: Cell) -> np.ndarray:
        """Points (M, T, P, C) of one sample for each observation."""
        actions = self.subject.sample(cell, self.rows, self.noise)[0]
        self._count(self._cost(cell, distribution=False))
        return self.measure.points(actions)

    def _distribution_samples(self, cell: Cell) -> list[np.ndarray]:
        """Points (N, T, P, C) of many samples, for each observation that gets them."""
        actions = self.subject.sample(cell, self.distribution_rows, self.distribution_noise)
        self._count(self.grid.evaluations[cell] * self.distribution_noise[..., 0, 0].numel())
        return list(np.moveaxis(self.measure.points(actions), 1, 0))

    def _cost(self, cell: Cell, *, distribution: bool) -> int:
        chunks = len(self.rows) + (self.distribution_noise[..., 0, 0].numel() if distribution else 0)
        return self.grid.evaluations[cell] * chunks

    def _count(self, evaluations: int) -> None:
        self.done += evaluations
        if self.progress is not None:
            self.progress(self.done, self.planned)


def _choose_rows(near: np.ndarray, size: int) -> np.ndarray:
    """Rows (size,) evenly from the observations near contact and, for what is missing, from the others."""
    touching, others = np.flatnonzero(near.any(1)), np.flatnonzero(~near.any(1))
    n_touching = min(len(touching), max(size // 2, size - len(others)))
    chosen = touching[evenly(len(touching), n_touching)], others[evenly(len(others), size - n_touching)]
    return np.sort(np.concatenate(chosen))


def _mean_at(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Mean (M,) of values (M, T) over the marked steps; NaN for none."""
    counts = at.sum(-1)
    return np.where(counts > 0, (values * at).sum(-1) / np.maximum(counts, 1), np.nan)
