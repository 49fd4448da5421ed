"""From demonstrations to a `ResolutionReport`."""

from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.diagnostics.core.measures import Measure, RawUnits, measure_of
from lerobot_act_chunking.diagnostics.core.noise_floor import measure_noise
from lerobot_act_chunking.diagnostics.resolution.report import ResolutionReport
from lerobot_act_chunking.diagnostics.resolution.settings import Question
from lerobot_act_chunking.diagnostics.resolution.spectrum import measure_spectrum
from lerobot_act_chunking.diagnostics.resolution.strides import (
    Tolerance,
    choose_strides,
    chunk_timing,
    measure_stride,
    recommend,
)
from lerobot_act_chunking.diagnostics.resolution.verdict import judge

MM, OF_RANGE = 0.5, 0.01
GRIPPERS_APART = "Millimetres are between the fingertips: how far grippers are open is not in them."
HELD = "Held between predictions, not interpolated, and not held against the tolerance: {names}."


def measure(demonstrations: ActionEpisodes, question: Question) -> ResolutionReport:
    """Reconstruct demonstrations at every stride, look at their spectrum, and recommend a stride.

    Raises:
        ConfigurationError: a question that cannot be answered, naming the value.
        DatasetError: no episode is as long as a chunk.
    """
    question.check(len(demonstrations.names))
    fps = demonstrations.fps
    chosen = choose_strides(question.strides, question.chunk_stride, question.horizon_s, fps)
    timings = [chunk_timing(stride, question.horizon_s, fps) for stride in chosen]
    in_space = measure_of({"names": list(demonstrations.names), "shape": (len(demonstrations.names),)})
    floor = measure_noise(list(demonstrations.episodes.values()), fps, demonstrations.names)
    spectrum = measure_spectrum(demonstrations, floor.moving)
    strides = [
        measure_stride(demonstrations, timing, in_space, spectrum, floor, question.gripper_dims)
        for timing in timings
    ]
    tolerance = _tolerance(question, in_space)
    recommended = recommend(strides, tolerance)
    judged = next((each for each in strides if each.stride == question.chunk_stride), recommended)
    return ResolutionReport(
        demonstrations=demonstrations,
        question=question,
        measure=in_space,
        spectrum=spectrum,
        strides=strides,
        tolerance=tolerance,
        recommended=recommended,
        judged=judged,
        floor=floor,
        judgement=judge(demonstrations, question, judged, recommended, tolerance, floor),
        notes=[*_notes(demonstrations, question, in_space), *floor.notes],
    )


def _tolerance(question: Question, measure: Measure) -> Tolerance:
    in_space = not isinstance(measure, RawUnits)
    usual = MM if in_space else OF_RANGE
    value = usual if question.tolerance is None else question.tolerance
    return Tolerance(value, measure.unit if in_space else "of range")


def _notes(demonstrations: ActionEpisodes, question: Question, measure: Measure) -> list[str]:
    notes = [] if isinstance(measure, RawUnits) else [GRIPPERS_APART]
    if question.gripper_dims:
        notes.append(HELD.format(names=", ".join(demonstrations.names[dim] for dim in question.gripper_dims)))
    return notes
