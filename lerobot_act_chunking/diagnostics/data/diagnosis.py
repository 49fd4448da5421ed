"""The whole diagnosis, from what is asked to the report."""

from lerobot_act_chunking.diagnostics.core.operators import read_operators
from lerobot_act_chunking.diagnostics.core.recording import read_metadata, read_recording
from lerobot_act_chunking.diagnostics.data.cameras import Progress, look
from lerobot_act_chunking.diagnostics.data.frames import cameras_of
from lerobot_act_chunking.diagnostics.data.measuring import measure, measure_motion, sound
from lerobot_act_chunking.diagnostics.data.report import DataReport
from lerobot_act_chunking.diagnostics.data.settings import Settings


def diagnose(settings: Settings, progress: Progress | None = None) -> DataReport:
    """What is this dataset like, and what should change before a policy learns from it?

    Args:
        settings: what is asked.
        progress: called with the number of pictures compared and planned.

    Raises:
        DatasetError: the dataset is damaged or empty.
        FeatureError: it lacks the column of operators that was named.
    """
    meta = read_metadata(settings.dataset)
    everything = read_recording(meta, read_operators(meta, settings.operator_column))
    broken = {each.index: each.broken for each in everything.episodes if each.broken}
    recording = sound(everything)
    indices = [each.index for each in recording.episodes]
    actions = measure_motion(recording.actions, indices, recording.fps, recording.action_names)
    moving = [~each.idle for each in actions.stillness]
    keys = [] if settings.cameras == "none" else cameras_of(meta)
    cameras = look(
        meta, keys, recording.episodes, moving, sample=settings.cameras == "sample", progress=progress
    )
    return measure(recording, actions, broken, cameras)
