"""From demonstrations to a `ResolutionReport`."""

from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.diagnostics.core.measures import Measure, RawUnits, measure_of
from lerobot_act_chunking.diagnostics.core.noise_floor import measure_noise
from lerobot_act_chunking.diagnostics.resolution.report import ResolutionReport
from lerobot_act_chunking.diagnostics.resolution.settings import Criteria
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


def measure(demonstrations: ActionEpisodes, criteria: Criteria) -> ResolutionReport:
    """Reconstruct demonstrations at every stride, look at their spectrum, and recommend a stride.

    Raises:
        ConfigurationError: criteria that no stride can meet, naming the value.
        DatasetError: no episode is as long as a chunk.
    """
    criteria.check(len(demonstrations.names))
    fps = demonstrations.fps
    chosen = choose_strides(criteria.strides, criteria.chunk_stride, criteria.horizon_s, fps)
    timings = [chunk_timing(stride, criteria.horizon_s, fps) for stride in chosen]
    in_space = measure_of({"names": list(demonstrations.names), "shape": (len(demonstrations.names),)})
    floor = measure_noise(list(demonstrations.episodes.values()), fps, demonstrations.names)
    spectrum = measure_spectrum(demonstrations, floor.moving)
    strides = [
        measure_stride(demonstrations, timing, in_space, spectrum, floor, criteria.gripper_dims)
        for timing in timings
    ]
    tolerance = _tolerance(criteria, in_space)
    recommended = recommend(strides, tolerance)
    judged = next((each for each in strides if each.stride == criteria.chunk_stride), recommended)
    return ResolutionReport(
        demonstrations=demonstrations,
        criteria=criteria,
        measure=in_space,
        spectrum=spectrum,
        strides=strides,
        tolerance=tolerance,
        recommended=recommended,
        judged=judged,
        floor=floor,
        judgement=judge(demonstrations, criteria, judged, recommended, tolerance, floor),
        notes=[*_notes(demonstrations, criteria, in_space), *floor.notes],
    )


def _tolerance(criteria: Criteria, measure: Measure) -> Tolerance:
    in_space = not isinstance(measure, RawUnits)
    usual = MM if in_space else OF_RANGE
    value = usual if criteria.tolerance is None else criteria.tolerance
    return Tolerance(value, measure.unit if in_space else "of range")


def _notes(demonstrations: ActionEpisodes, criteria: Criteria, measure: Measure) -> list[str]:
    notes = [] if isinstance(measure, RawUnits) else [GRIPPERS_APART]
    if criteria.gripper_dims:
        notes.append(HELD.format(names=", ".join(demonstrations.names[dim] for dim in criteria.gripper_dims)))
    return notes
