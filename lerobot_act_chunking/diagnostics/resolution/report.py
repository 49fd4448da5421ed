"""Everything the diagnosis found, as one object: the command prints it, JSON holds it, plots draw it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np

from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.diagnostics.core.measures import Measure
from lerobot_act_chunking.diagnostics.core.noise_floor import NoiseFloor
from lerobot_act_chunking.diagnostics.core.report import Report
from lerobot_act_chunking.diagnostics.resolution.settings import Criteria
from lerobot_act_chunking.diagnostics.resolution.spectrum import Spectrum
from lerobot_act_chunking.diagnostics.resolution.strides import Stride, Tolerance
from lerobot_act_chunking.diagnostics.resolution.verdict import FEWEST_STEPS, MOST_ABOVE_NYQUIST


@dataclass(frozen=True, kw_only=True)
class ResolutionReport(Report):
    """The answer to: how far apart may predictions lie?

    Attributes:
        demonstrations: the data.
        criteria: what strides are held against.
        measure: what actions mean in space.
        spectrum: of the actions.
        strides: the ones tried, the smallest first.
        tolerance: what was held against them.
        recommended: the largest up to which all are within it.
        judged: the one in question: that of ``criteria.chunk_stride``, or the recommended one.
        floor: which dimensions move.
        notes: what to know about the figures.
    """

    tool: ClassVar[str] = "resolution"
    demonstrations: ActionEpisodes
    criteria: Criteria
    measure: Measure
    spectrum: Spectrum
    strides: list[Stride]
    tolerance: Tolerance
    recommended: Stride
    judged: Stride
    floor: NoiseFloor
    notes: list[str]

    @property
    def flags(self) -> str:
        """The recommendation as options of ``lerobot-train``."""
        timing = self.recommended.timing
        return f"--policy.chunk_stride={timing.chunk_stride} --policy.chunk_size={timing.chunk_size}"

    def content(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None for what was not or cannot be measured."""
        return {
            "dataset": self.demonstrations.folder,
            "n_episodes": len(self.demonstrations.episodes),
            "fps": self.demonstrations.fps,
            "question": asdict(self.criteria),
            "verdict": self.verdict,
            "reasons": self.reasons,
            "thresholds": {
                "tolerance": self.tolerance.value,
                "tolerance_unit": self.tolerance.unit,
                "most_above_nyquist": MOST_ABOVE_NYQUIST,
                "fewest_steps": FEWEST_STEPS,
            },
            "recommended": {
                "chunk_stride": self.recommended.timing.chunk_stride,
                "chunk_size": self.recommended.timing.chunk_size,
            },
            "unit": self.measure.unit,
            "judged": self.judged.stride,
            "dimensions": self.floor.to_json(),
            "strides": [_stride_json(stride) for stride in self.strides],
            "notes": self.notes,
        }


def _stride_json(stride: Stride) -> dict[str, Any]:
    found = stride.reconstruction
    dimensions: Sequence[float] = stride.dimensions_above_nyquist.tolist()
    return {
        "chunk_stride": stride.stride,
        "chunk_size": stride.timing.chunk_size,
        "predictions_per_second": stride.predictions_per_second,
        "nyquist_hz": stride.nyquist_hz,
        "worst_p95": _known(stride.worst),
        "above_nyquist": _known(stride.above_nyquist),
        "n_chunks": found.n_chunks,
        "farthest": found.farthest and asdict(found.farthest),
        "points": [asdict(point) for point in found.points],
        "dimensions": [
            {**asdict(deviation), "above_nyquist": _known(share)}
            for deviation, share in zip(found.dimensions, dimensions, strict=True)
        ],
    }


def _known(number: float) -> float | None:
    return None if np.isnan(number) else float(number)
