"""What is lost between a chunk and what its codes stand for."""

from dataclasses import dataclass

import numpy as np

from lerobot_act_chunking.diagnostics.codebook.chunks import CodedChunks
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.diagnostics.core.measures import Measure, RawUnits

WORST = 5


@dataclass(frozen=True)
class Loss:
    """Absolute error of one action dimension in raw units, or of a point in space.

    Attributes:
        lost_variance: share of this dimension's variance; None for a point, and where nothing varies.
    """

    name: str
    mean: float
    p95: float
    lost_variance: float | None = None


@dataclass(frozen=True)
class WorstChunk:
    """A chunk that its codes say badly.

    Attributes:
        time_s: from the episode's start to that of the chunk [s].
        name: the dimension that is farthest off ...
        error: ... and by how much, in raw units, at its worst step.
        rms: of the whole chunk in normalised units.
    """

    episode: int
    time_s: float
    name: str
    error: float
    rms: float


@dataclass(frozen=True)
class Losses:
    """All of it.

    Attributes:
        dimensions: raw units.
        points: the same in space, where `measure` knows how; in its ``unit``.
        worst: chunks, the worst first, no two of which overlap.
        lost_variance: mean share over the dimensions that vary, whatever they were normalised by.
    """

    dimensions: list[Loss]
    points: list[Loss]
    unit: str
    worst: list[WorstChunk]
    lost_variance: float


def measure_losses(coded: CodedChunks, demonstrations: ActionEpisodes, measure: Measure) -> Losses:
    """Errors of coded chunks that come from these demonstrations."""
    shares = coded.lost_variance
    dimensions = [
        Loss(name, *_mean_p95(error), None if np.isnan(share) else float(share))
        for name, error, share in zip(
            demonstrations.names, np.moveaxis(coded.errors, -1, 0), shares, strict=True
        )
    ]
    return Losses(
        dimensions=dimensions,
        points=[] if isinstance(measure, RawUnits) else _points(coded, measure),
        unit=measure.unit,
        worst=_worst(coded, demonstrations),
        lost_variance=0.0 if np.isnan(shares).all() else float(np.nanmean(shares)),
    )


def _points(coded: CodedChunks, measure: Measure) -> list[Loss]:
    valid = ~coded.chunks.is_pad
    apart = measure.points(coded.decoded[valid]) - measure.points(coded.chunks.actions[valid])
    distances = np.linalg.norm(apart, axis=-1)  # (valid steps, P)
    return [Loss(name, *_mean_p95(error)) for name, error in zip(measure.names, distances.T, strict=True)]


def _mean_p95(errors: np.ndarray) -> tuple[float, float]:
    return float(np.nanmean(errors)), float(np.nanpercentile(errors, 95))


def _worst(coded: CodedChunks, demonstrations: ActionEpisodes) -> list[WorstChunk]:
    chunks, rms = coded.chunks, coded.chunk_errors
    found: list[int] = []
    for row in np.argsort(-rms):
        if all(not _overlap(coded, row, other) for other in found):
            found.append(int(row))
        if len(found) == WORST:
            break
    errors = np.nan_to_num(coded.errors[found]).max(1)  # (worst, A)
    dims = np.where(chunks.moving, coded.lost[found], -1.0).argmax(1)
    return [
        WorstChunk(
            episode=int(chunks.episode[row]),
            time_s=float(chunks.step[row] / demonstrations.fps),
            name=demonstrations.names[int(dim)],
            error=float(error[dim]),
            rms=float(rms[row]),
        )
        for row, dim, error in zip(found, dims, errors, strict=True)
    ]


def _overlap(coded: CodedChunks, row: int, other: int) -> bool:
    chunks = coded.chunks
    same = chunks.episode[row] == chunks.episode[other]
    return bool(same and abs(chunks.step[row] - chunks.step[other]) < chunks.control_steps)
