"""Demonstrations of a scripted expert into a dataset."""

from collections.abc import Callable
from pathlib import Path

from lerobot_act_chunking.recording.recorder import RecordingProgress, RecordResult, Target, record_source
from lerobot_act_chunking.recording.spec import RecordSpec


def record(
    spec: RecordSpec, *, progress: Callable[[RecordingProgress], None] = lambda _: None
) -> RecordResult:
    """Record demonstrations of a task, or finish doing so; see ``record_source``.

    Args:
        spec: what to record.
        progress: called after every attempt.

    Raises:
        ConfigurationError: the dataset's folder holds something else or cannot be written, or the recording
            begun there had other settings.
        DatasetError: an episode that is not finite, an expert that keeps failing, a full disk.
        WorkerError: workers died again and again.
    """
    target = Target(_root(spec), spec.repo_id, spec.episodes, spec.seed)
    return record_source(spec.source(), target, workers=spec.workers, cluster=spec.cluster, progress=progress)


def _root(spec: RecordSpec) -> Path:
    if spec.root is not None:
        return spec.root.expanduser().resolve()
    from lerobot.utils.constants import HF_LEROBOT_HOME

    return HF_LEROBOT_HOME / spec.repo_id
