"""Every stride in question: what it costs, what it loses, and which one to take."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_act_chunking.data.dimension_names import is_hand
from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.diagnostics.core.measures import Measure
from lerobot_act_chunking.diagnostics.core.noise_floor import NoiseFloor
from lerobot_act_chunking.diagnostics.resolution.reconstruction import Reconstruction, reconstruct
from lerobot_act_chunking.diagnostics.resolution.spectrum import Spectrum
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.seconds import to_chunk_size

USUAL = (1, 2, 3, 4, 5, 8, 10, 16, 20, 25, 32, 40, 50)


@dataclass(frozen=True)
class Tolerance:
    """What an interpolated action may be off, in 95 % of the control steps.

    Attributes:
        value: in millimetres, or as a share of each dimension's range.
        unit: ``mm``, or ``of range``.
    """

    value: float
    unit: str

    def __str__(self) -> str:
        return f"{self.value:g} mm" if self.unit == "mm" else f"{self.value:.2g} of each range"


@dataclass(frozen=True)
class Stride:
    """One stride.

    Attributes:
        timing: its chunks.
        fps: control steps per second.
        reconstruction: what interpolation makes of the demonstrations.
        worst: 95 % deviation in units of the tolerance: of the farthest point, or of the worst dimension that
            counts.
        shares: 95 % deviation of each dimension (A,) as a share of its range; 0 below its quantisation step,
            NaN where it does not move.
        above_nyquist: share of the energy above half the rate of predictions.
        dimensions_above_nyquist: the same by dimension (A,); NaN where nothing moves.
    """

    timing: ChunkTiming
    fps: float
    reconstruction: Reconstruction
    worst: float
    shares: np.ndarray
    above_nyquist: float
    dimensions_above_nyquist: np.ndarray

    @property
    def stride(self) -> int:
        """Control steps between predictions."""
        return self.timing.chunk_stride

    @property
    def nyquist_hz(self) -> float:
        """Half the rate of predictions [Hz]."""
        return self.fps / (2 * self.stride)

    @property
    def predictions_per_second(self) -> float:
        """Of horizon: tokens that the policy has to produce."""
        return self.fps / self.stride


def chunk_timing(stride: int, horizon_s: float, fps: float) -> ChunkTiming:
    """The chunks that cover a horizon.

    Raises:
        ConfigurationError: the horizon is shorter than two predictions.
    """
    timing = ChunkTiming(1, max(2, to_chunk_size(horizon_s, fps, stride)), stride)
    if stride > round(horizon_s * fps):
        raise ConfigurationError(
            f"chunk_stride={stride} lasts {stride / fps:.3g} s, longer than --horizon-s={horizon_s:g}: "
            "choose a longer horizon or a smaller stride"
        )
    return timing


def choose_strides(requested: Sequence[int], also: int | None, horizon_s: float, fps: float) -> list[int]:
    """The strides to try: those requested, or the usual ones a horizon has room for; ``also``; and 1."""
    n_steps = round(horizon_s * fps)
    wanted = set(requested) or {stride for stride in USUAL if 2 * stride < n_steps}
    return sorted(wanted | {1} | (set() if also is None else {also}))


def measure_stride(
    demonstrations: ActionEpisodes,
    timing: ChunkTiming,
    measure: Measure,
    spectrum: Spectrum,
    floor: NoiseFloor,
    gripper_dims: Sequence[int],
) -> Stride:
    """What one stride loses; hands and what leaps do not count for the worst dimension."""
    found = reconstruct(demonstrations, timing, measure, gripper_dims)
    shares = _shares(demonstrations, found, floor)
    nyquist = demonstrations.fps / (2 * timing.chunk_stride)
    return Stride(
        timing=timing,
        fps=demonstrations.fps,
        reconstruction=found,
        worst=_worst(found, shares, counting(floor, gripper_dims)),
        shares=shares,
        above_nyquist=spectrum.all_above(nyquist),
        dimensions_above_nyquist=spectrum.above(nyquist),
    )


def counting(floor: NoiseFloor, gripper_dims: Sequence[int]) -> list[int]:
    """Dimensions that decide about strides: the moving ones of arms; or all that move, if no arm does.

    Hands and what leaps from one value to another are held by policies (``gripper_dims``), not interpolated.
    """
    moving = [dim for dim in floor.moving if dim not in gripper_dims]
    arms = [dim for dim in moving if dim not in floor.switching and not is_hand(floor.dimensions[dim].name)]
    return arms or moving


def _shares(demonstrations: ActionEpisodes, found: Reconstruction, floor: NoiseFloor) -> np.ndarray:
    spans = np.ptp(np.concatenate(list(demonstrations.episodes.values())), axis=0).astype(np.float64)
    shares = np.full(len(spans), np.nan)
    for dim in floor.moving:
        error = found.dimensions[dim].p95
        shares[dim] = error / spans[dim] if error > floor.dimensions[dim].step else 0.0
    return shares


def _worst(found: Reconstruction, shares: np.ndarray, counted: Sequence[int]) -> float:
    if found.farthest is not None:
        return found.farthest.p95
    return max((float(shares[dim]) for dim in counted), default=math.nan)


def recommend(strides: Sequence[Stride], tolerance: Tolerance) -> Stride:
    """The largest stride up to which all are within the tolerance; the first loses nothing."""
    best, *others = strides
    for stride in others:
        if not stride.worst <= tolerance.value:
            break
        best = stride
    return best
