"""Demonstrations sampled every few control steps, and interpolated as policies do with predictions."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes, evenly
from lerobot_act_chunking.diagnostics.core.measures import Measure, RawUnits, distances
from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.execution.interpolation import upsample

MOST_CHUNKS = 400


@dataclass(frozen=True)
class Deviation:
    """How far something is from where it was demonstrated, over all control steps."""

    name: str
    rms: float
    p95: float
    max: float

    @classmethod
    def of(cls, name: str, errors: np.ndarray) -> "Deviation":
        """Of absolute errors of any shape."""
        errors = errors.astype(np.float64)
        rms = np.sqrt(np.square(errors).mean())
        return cls(name, float(rms), float(np.percentile(errors, 95)), float(errors.max()))


@dataclass(frozen=True)
class Reconstruction:
    """What interpolation makes of demonstrated chunks.

    Attributes:
        dimensions: deviation of each action dimension in raw units.
        points: of each point in space, where the measure knows any; in its unit.
        farthest: of the point that is farthest off at each step.
        n_chunks: chunks that were interpolated.
    """

    dimensions: list[Deviation]
    points: list[Deviation]
    farthest: Deviation | None
    n_chunks: int


def reconstruct(
    demonstrations: ActionEpisodes, timing: ChunkTiming, measure: Measure, gripper_dims: Sequence[int]
) -> Reconstruction:
    """Sample chunks at ``timing.chunk_stride``, interpolate them, and compare at every control step.

    Chunks begin at all control steps, evenly thinned out, and lie within their episode. The steps that are
    sampled count, too: they have no error, and the robot executes them.

    Args:
        demonstrations: actions in raw units.
        timing: of the chunks.
        measure: what actions mean in space.
        gripper_dims: dimensions that are held between predictions instead of interpolated.

    Raises:
        DatasetError: no episode is as long as a chunk.
    """
    dense = whole_chunks(demonstrations, timing.control_steps)
    keyframes = torch.from_numpy(dense[:, :: timing.chunk_stride])
    interpolated = upsample(keyframes, timing.chunk_stride, gripper_dims).numpy()
    errors = np.abs(interpolated - dense)
    points, farthest = _in_space(interpolated, dense, measure)
    return Reconstruction(
        dimensions=[Deviation.of(name, errors[..., dim]) for dim, name in enumerate(demonstrations.names)],
        points=points,
        farthest=farthest,
        n_chunks=len(dense),
    )


def whole_chunks(demonstrations: ActionEpisodes, control_steps: int) -> np.ndarray:
    """Stretches (N, T, A) of that many control steps, in double precision.

    Raises:
        DatasetError: no episode is as long.
    """
    episodes = demonstrations.episodes
    starts = [(each, n) for each, rows in episodes.items() for n in range(len(rows) - control_steps + 1)]
    if not starts:
        raise DatasetError(
            f"no episode of {demonstrations.folder} is as long as a chunk of {control_steps} control steps, "
            f"the longest has {max(map(len, episodes.values()))}: choose a shorter --horizon-s"
        )
    kept = evenly(len(starts), MOST_CHUNKS)
    chunks = [episodes[each][first : first + control_steps] for each, first in (starts[i] for i in kept)]
    return np.stack(chunks).astype(np.float64)


def _in_space(
    interpolated: np.ndarray, dense: np.ndarray, measure: Measure
) -> tuple[list[Deviation], Deviation | None]:
    if isinstance(measure, RawUnits):
        return [], None
    ours, theirs = measure.points(interpolated), measure.points(dense)
    apart = np.linalg.norm(ours - theirs, axis=-1)  # (N, T, P)
    points = [Deviation.of(name, apart[..., point]) for point, name in enumerate(measure.names)]
    return points, Deviation.of("farthest", distances(ours, theirs))
