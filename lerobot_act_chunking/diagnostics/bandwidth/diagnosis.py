"""The whole diagnosis, from what is asked to the report."""

from collections.abc import Callable

from lerobot_act_chunking.diagnostics.bandwidth.measuring import measure
from lerobot_act_chunking.diagnostics.bandwidth.report import BandwidthReport
from lerobot_act_chunking.diagnostics.bandwidth.settings import Settings
from lerobot_act_chunking.diagnostics.bandwidth.source import read_source

DEFAULT_FPS = 50.0


def diagnose(settings: Settings, progress: Callable[[int, int], None] | None = None) -> BandwidthReport:
    """How fast can a policy react that executes its chunks like this?

    Args:
        settings: what is asked.
        progress: called with the numbers of pushed episodes finished and planned.

    Raises:
        ConfigurationError: no such checkpoint, or settings that cannot work.
        FeatureError: a push, and a policy for another robot or control rate.
    """
    source = read_source(settings.checkpoint, settings.execution)
    push, fps = None, settings.fps
    if settings.push is not None:
        from lerobot_act_chunking.diagnostics.bandwidth.push import study_push  # with MuJoCo

        push = study_push(source, **vars(settings.push), progress=progress)
        fps = push.fps if fps is None else fps
    return measure(source, source.fps or DEFAULT_FPS if fps is None else fps, settings.limits, push)
