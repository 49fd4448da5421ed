"""The whole diagnosis, from what is asked to the report."""

from dataclasses import replace

from lerobot_act_chunking.diagnostics.core.executable import read_executable
from lerobot_act_chunking.diagnostics.core.operators import read_operators
from lerobot_act_chunking.diagnostics.core.recorded import learned_episodes, open_recorded
from lerobot_act_chunking.diagnostics.core.recording import read_metadata, read_recording
from lerobot_act_chunking.diagnostics.core.report import with_untrained
from lerobot_act_chunking.diagnostics.core.training import read_training, untrained
from lerobot_act_chunking.diagnostics.replay.measuring import Subject, choose, measure
from lerobot_act_chunking.diagnostics.replay.report import ReplayReport
from lerobot_act_chunking.diagnostics.replay.settings import Settings
from lerobot_act_chunking.errors import DatasetError


def diagnose(settings: Settings) -> ReplayReport:
    """What would this policy do where the demonstrators were?

    Args:
        settings: what is asked.

    Raises:
        ConfigurationError: a checkpoint that cannot be used.
        DatasetError: the dataset is damaged or empty, or has no such episodes.
        FeatureError: it lacks what the policy observes, or is another robot's.
    """
    executable = read_executable(settings.checkpoint)
    fps = read_training(settings.checkpoint, executable.config).fps
    dataset = open_recorded(settings.dataset, executable.config, fps)
    meta = read_metadata(settings.dataset)
    recording = read_recording(meta, read_operators(meta))
    broken = [each.index for each in recording.episodes if each.broken]
    if broken:
        raise DatasetError(
            f"the dataset at {settings.dataset} is not finite in episodes {broken}: leave them out"
        )
    there = [each.index for each in recording.episodes]
    learned = learned_episodes(settings.dataset, settings.checkpoint, executable.config, there)
    chosen = choose(there, learned, settings)
    policy = executable.load()
    if getattr(policy.policy.config, "background", False):  # what comes of it would depend on the machine
        policy.policy.config.background = False
    subject = Subject(policy, executable.policy_type, dataset, recording, chosen, learned)
    report = measure(subject, settings)
    return replace(report, judgement=with_untrained(report.judgement, untrained(settings.checkpoint)))
