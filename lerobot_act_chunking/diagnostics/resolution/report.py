"""Everything the diagnosis found, as one object: the command prints it, JSON holds it, plots draw it."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_act_chunking.diagnostics.core import outcome
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.diagnostics.core.measures import Measure, RawUnits, measure_of
from lerobot_act_chunking.diagnostics.core.noise_floor import NoiseFloor, measure_noise
from lerobot_act_chunking.diagnostics.resolution.spectrum import Spectrum, measure_spectrum
from lerobot_act_chunking.diagnostics.resolution.strides import (
    Stride,
    Tolerance,
    choose_strides,
    chunk_timing,
    counting,
    measure_stride,
    recommend,
)
from lerobot_act_chunking.errors import ConfigurationError

MOST_ABOVE_NYQUIST = 0.01
FEWEST_STEPS = 256
MM, OF_RANGE = 0.5, 0.01

GRIPPERS_APART = "Millimetres are between the fingertips: how far grippers are open is not in them."
HELD = "Held between predictions, not interpolated, and not held against the tolerance: {names}."


@dataclass(frozen=True)
class Question:
    """What is asked of a dataset.

    Attributes:
        horizon_s: time that a chunk covers [s].
        strides: control steps between predictions to try; none for the usual ones.
        chunk_stride: the one to judge, if any.
        tolerance: in millimetres where positions are known, else a share of each dimension's range; None for
            half a millimetre, or a hundredth.
        gripper_dims: dimensions that the policy holds between predictions.
    """

    horizon_s: float = 2.0
    strides: tuple[int, ...] = ()
    chunk_stride: int | None = None
    tolerance: float | None = None
    gripper_dims: tuple[int, ...] = ()

    def check(self, n_dims: int) -> None:
        """Refuse what cannot be answered.

        Raises:
            ConfigurationError: naming the value and the way out.
        """
        if not (self.horizon_s > 0 and math.isfinite(self.horizon_s)):
            raise ConfigurationError(f"horizon_s={self.horizon_s:g} must be above 0, and finite")
        if self.tolerance is not None and not (self.tolerance > 0 and math.isfinite(self.tolerance)):
            raise ConfigurationError(f"tolerance={self.tolerance:g} must be above 0, and finite")
        for stride in (*self.strides, *([] if self.chunk_stride is None else [self.chunk_stride])):
            if stride < 1:
                raise ConfigurationError(f"a stride of {stride} must be at least 1 control step")
        for dim in self.gripper_dims:
            if not 0 <= dim < n_dims:
                raise ConfigurationError(
                    f"gripper_dims={list(self.gripper_dims)}: {dim} is no dimension of these actions, which "
                    f"have {n_dims}, from 0"
                )


@dataclass(frozen=True)
class ResolutionReport:
    """The answer to: how far apart may predictions lie?

    Attributes:
        demonstrations: the data.
        question: what was asked.
        measure: what actions mean in space.
        spectrum: of the actions.
        strides: the ones tried, the smallest first.
        tolerance: what was held against them.
        recommended: the largest up to which all are within it.
        judged: the one in question: that of ``question.chunk_stride``, or the recommended one.
        floor: which dimensions move.
        verdict: pass, warn, fail or inconclusive ...
        reasons: ... and why.
        notes: what to know about the figures.
    """

    demonstrations: ActionEpisodes
    question: Question
    measure: Measure
    spectrum: Spectrum
    strides: list[Stride]
    tolerance: Tolerance
    recommended: Stride
    judged: Stride
    floor: NoiseFloor
    verdict: str
    reasons: list[str]
    notes: list[str]

    @property
    def exit_code(self) -> int:
        """Of the command: 0 pass or warn, 1 fail, 2 inconclusive."""
        return outcome.EXIT_CODES[self.verdict]

    @property
    def flags(self) -> str:
        """The recommendation as options of ``lerobot-train``."""
        timing = self.recommended.timing
        return f"--policy.chunk_stride={timing.chunk_stride} --policy.chunk_size={timing.chunk_size}"

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None for what cannot be measured."""
        return {
            "tool": "resolution",
            "version": version("lerobot_policy_act_chunking"),
            "dataset": self.demonstrations.folder,
            "n_episodes": len(self.demonstrations.episodes),
            "fps": self.demonstrations.fps,
            "question": asdict(self.question),
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

    def write_json(self, path: Path) -> Path:
        """Write `to_json` to a file, creating its folder."""
        return outcome.write_json(self.to_json(), path)


def diagnose(demonstrations: ActionEpisodes, question: Question) -> ResolutionReport:
    """Reconstruct demonstrations at every stride, look at their spectrum, and recommend a stride.

    Raises:
        ConfigurationError: a question that cannot be answered, naming the value.
        DatasetError: no episode is as long as a chunk.
    """
    question.check(len(demonstrations.names))
    fps = demonstrations.fps
    chosen = choose_strides(question.strides, question.chunk_stride, question.horizon_s, fps)
    timings = [chunk_timing(stride, question.horizon_s, fps) for stride in chosen]
    measure = measure_of({"names": list(demonstrations.names), "shape": (len(demonstrations.names),)})
    floor = measure_noise(list(demonstrations.episodes.values()), fps, demonstrations.names)
    spectrum = measure_spectrum(demonstrations, floor.moving)
    strides = [
        measure_stride(demonstrations, timing, measure, spectrum, floor, question.gripper_dims)
        for timing in timings
    ]
    tolerance = _tolerance(question, measure)
    recommended = recommend(strides, tolerance)
    judged = next((each for each in strides if each.stride == question.chunk_stride), recommended)
    verdict, reasons = _judge(demonstrations, question, judged, recommended, tolerance, floor)
    return ResolutionReport(
        demonstrations=demonstrations,
        question=question,
        measure=measure,
        spectrum=spectrum,
        strides=strides,
        tolerance=tolerance,
        recommended=recommended,
        judged=judged,
        floor=floor,
        verdict=verdict,
        reasons=reasons,
        notes=[*_notes(demonstrations, question, measure), *floor.notes],
    )


def _tolerance(question: Question, measure: Measure) -> Tolerance:
    in_space = not isinstance(measure, RawUnits)
    usual = MM if in_space else OF_RANGE
    value = usual if question.tolerance is None else question.tolerance
    return Tolerance(value, measure.unit if in_space else "of range")


def _judge(
    demonstrations: ActionEpisodes,
    question: Question,
    judged: Stride,
    recommended: Stride,
    tolerance: Tolerance,
    floor: NoiseFloor,
) -> tuple[str, list[str]]:
    n_steps = sum(map(len, demonstrations.episodes.values()))
    if n_steps < FEWEST_STEPS:
        return "inconclusive", [f"{n_steps} control steps are too few to judge by, it takes {FEWEST_STEPS}"]
    if np.isnan(judged.above_nyquist):
        return "inconclusive", [_nothing_moves(floor)]
    if not judged.worst <= tolerance.value:
        return "fail", [_too_coarse(judged, recommended, tolerance)]
    within = f"at chunk_stride={judged.stride} {_told(judged, tolerance)} (95 % of the steps)"
    reasons = [f"{within}, allowed {tolerance}"]
    counted = counting(floor, question.gripper_dims)
    fast = [
        f"{demonstrations.names[dim]} ({share:.1%})"
        for dim in counted
        if (share := judged.dimensions_above_nyquist[dim]) > MOST_ABOVE_NYQUIST
    ]
    if fast:
        reasons.append(
            f"but energy lies above {judged.nyquist_hz:.3g} Hz, which predictions so far apart cannot show, "
            f"and returns as slower motion that nobody demonstrated: {', '.join(fast)}"
        )
    hold = [] if tolerance.unit == "mm" else _to_hold(judged, floor, question, tolerance)
    if hold:
        named = ", ".join(f"{demonstrations.names[dim]} ({judged.shares[dim]:.1%})" for dim in hold)
        dims = ",".join(map(str, sorted({*hold, *question.gripper_dims})))
        reasons.append(
            f"but hands or grippers are farther off: {named}; hold them between predictions: --gripper-dims "
            f"{dims} here, --policy.gripper_dims=[{dims}] of the policy"
        )
    return "warn" if len(reasons) > 1 else "pass", reasons


def _to_hold(judged: Stride, floor: NoiseFloor, question: Question, tolerance: Tolerance) -> list[int]:
    """Moving dimensions that did not count, and are too far off."""
    apart = {*floor.moving} - {*counting(floor, question.gripper_dims)} - {*question.gripper_dims}
    return [dim for dim in sorted(apart) if judged.shares[dim] > tolerance.value]


def _nothing_moves(floor: NoiseFloor) -> str:
    still = all(found.kind == "constant" for found in floor.dimensions)
    told = "no action ever changes" if still else "no action moves beyond its own noise"
    return f"{told}: there is nothing to resolve"


def _too_coarse(judged: Stride, recommended: Stride, tolerance: Tolerance) -> str:
    told = f"chunk_stride={judged.stride} is too coarse: {_told(judged, tolerance)} (95 % of the steps)"
    return f"{told}, allowed {tolerance}; take chunk_stride={recommended.stride}"


def _told(stride: Stride, tolerance: Tolerance) -> str:
    if tolerance.unit == "mm":
        return f"a gripper is up to {stride.worst:.2g} mm off"
    return f"a joint is up to {stride.worst:.2%} of its range off"


def _notes(demonstrations: ActionEpisodes, question: Question, measure: Measure) -> list[str]:
    notes = [] if isinstance(measure, RawUnits) else [GRIPPERS_APART]
    if question.gripper_dims:
        notes.append(HELD.format(names=", ".join(demonstrations.names[dim] for dim in question.gripper_dims)))
    return notes


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
