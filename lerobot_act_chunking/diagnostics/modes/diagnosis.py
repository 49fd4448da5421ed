"""The whole diagnosis, from what is asked to the report."""

from dataclasses import replace
from typing import Any

from lerobot_act_chunking.data.actions import is_dataset
from lerobot_act_chunking.diagnostics.core.clock import Progress
from lerobot_act_chunking.diagnostics.core.environments import environment_of
from lerobot_act_chunking.diagnostics.core.report import with_untrained
from lerobot_act_chunking.diagnostics.core.success_keys import never_said
from lerobot_act_chunking.diagnostics.core.training import read_training, untrained
from lerobot_act_chunking.diagnostics.modes.demonstrated import Demonstrated, read_demonstrated
from lerobot_act_chunking.diagnostics.modes.measuring import measure
from lerobot_act_chunking.diagnostics.modes.playing import play
from lerobot_act_chunking.diagnostics.modes.report import ModesReport
from lerobot_act_chunking.diagnostics.modes.settings import Settings
from lerobot_act_chunking.policies.loading import check_complete, load_policy, read_config


def diagnose(settings: Settings, progress: Progress | None = None) -> ModesReport:
    """Does a policy take the ways that were demonstrated, as often; if not, why?

    Args:
        settings: what is asked.
        progress: called with the numbers of episodes done and planned.

    Raises:
        ConfigurationError: a checkpoint or an environment that cannot be used.
        FeatureError: the environment or the dataset lacks what the policy observes.
        DatasetError: a dataset that was asked for and cannot be read.
    """
    config = read_config(settings.checkpoint)
    check_complete(settings.checkpoint, config.type)
    env_config = environment_of(config, settings.environment, settings.checkpoint)
    demonstrated = _demonstrated(settings, config)
    loaded = load_policy(settings.checkpoint)
    rollouts = play(settings, env_config, progress)
    report = measure(settings, loaded, rollouts, demonstrated)
    judgement = with_untrained(report.judgement, untrained(settings.checkpoint))
    unknown = never_said(env_config, [rollout.instead for rollout in rollouts])
    notes = report.notes if unknown is None else [*report.notes, unknown[:1].upper() + unknown[1:] + "."]
    return replace(report, judgement=judgement, notes=notes)


def _demonstrated(settings: Settings, config: Any) -> Demonstrated | None:
    """The demonstrations that are asked for, or those of the training, if they are here."""
    if settings.dataset is not None:
        return read_demonstrated(settings.dataset)
    training = read_training(settings.checkpoint, config)
    if training.folder is None or not is_dataset(training.folder):
        return None
    return read_demonstrated(training.folder, training.episodes)
