"""The whole diagnosis, from what is asked to the report."""

import time
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from lerobot.envs.configs import EnvConfig

from lerobot_act_chunking.diagnostics.core.clock import Clock, Progress
from lerobot_act_chunking.diagnostics.core.digests import checkpoint_digest, environment_identity
from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec, action_names, environment_of
from lerobot_act_chunking.diagnostics.core.executable import (
    Executable,
    draws_noise,
    predicting,
    read_executable,
    smoothing_to_try,
)
from lerobot_act_chunking.diagnostics.core.outcomes import Outcomes
from lerobot_act_chunking.diagnostics.diagnose.demonstrations import Demonstrations, find_demonstrations
from lerobot_act_chunking.diagnostics.diagnose.laboratory import Laboratory, open_laboratory
from lerobot_act_chunking.diagnostics.diagnose.looking import Seen, look
from lerobot_act_chunking.diagnostics.diagnose.measuring import Measured, intervene, search_moments
from lerobot_act_chunking.diagnostics.diagnose.moments import repeats_itself
from lerobot_act_chunking.diagnostics.diagnose.playing import Stage, later_checkpoint
from lerobot_act_chunking.diagnostics.diagnose.report import DiagnoseReport
from lerobot_act_chunking.diagnostics.diagnose.settings import Settings
from lerobot_act_chunking.diagnostics.diagnose.trials import make_trials
from lerobot_act_chunking.diagnostics.diagnose.verdict import judge

DEFAULT_PARENT = Path("outputs/diagnose")
TO_REPEAT = 2
"""Episodes by which it is tried whether an environment repeats itself."""


def diagnose(settings: Settings, progress: Progress | None = None) -> DiagnoseReport:
    """Why does a policy fail, and what should change?

    Args:
        settings: what is asked.
        progress: called with the numbers of episodes done and planned so far.

    Raises:
        ConfigurationError: a checkpoint, an environment or a folder that cannot be used, or an environment
            that says nothing of success.
        DatasetError: no usable dataset.
        FeatureError: the environment or dataset lacks what the policy observes.
    """
    started = time.monotonic()
    executable = read_executable(settings.checkpoint)
    config = predicting(executable.config)
    demonstrations = find_demonstrations(settings.dataset, settings.checkpoint, config)
    if settings.environment is None:
        report = _without_environment(settings, executable, demonstrations)
    else:
        clock = Clock(started + 60 * settings.minutes, progress)
        report = _in_environment(settings, settings.environment, executable, demonstrations, clock)
    return replace(report, minutes=(time.monotonic() - started) / 60)


def _without_environment(
    settings: Settings, executable: Executable, demonstrations: Demonstrations | None
) -> DiagnoseReport:
    seen = look(executable, executable.load(), demonstrations, None, [])
    return DiagnoseReport(
        requested=settings,
        policy_type=executable.policy_type,
        where=settings.dataset or "",
        dt=None,
        seen=seen,
        measured=None,
        judgement=judge(None, seen),
        minutes=0.0,
        notes=[],
    )


def _in_environment(
    settings: Settings,
    environment: EnvironmentSpec,
    executable: Executable,
    demonstrations: Demonstrations | None,
    clock: Clock,
) -> DiagnoseReport:
    env_config = environment_of(executable.config, environment, settings.checkpoint)
    policy = executable.load()
    store = Outcomes(_question(settings, env_config), settings.output_dir, DEFAULT_PARENT)
    (width,) = executable.config.action_feature.shape
    names = action_names(env_config, width, settings.checkpoint)
    repeats = None
    stage = Stage(executable, env_config)
    with open_laboratory(
        stage, store, clock, batch_size=settings.batch_size, workers=settings.workers, names=names
    ) as laboratory:
        records = laboratory.record(range(settings.seed, settings.seed + settings.episodes))
        seen = look(executable, policy, demonstrations, env_config, records)
        measured = Measured(records, complete=laboratory.complete)
        if not measured.is_healthy and not measured.too_few and not _hopeless(seen):
            measured = _intervened(settings, executable, demonstrations, seen, laboratory, measured)
            repeats = repeats_itself(env_config, executable.config, measured.failures[:TO_REPEAT])
            if repeats:
                moments = search_moments(laboratory, measured)
                measured = replace(measured, moments=moments, complete=laboratory.complete)
    return DiagnoseReport(
        requested=settings,
        policy_type=executable.policy_type,
        where=environment.name,
        dt=1 / env_config.fps,
        seen=seen,
        measured=measured,
        judgement=judge(measured, seen),
        repeats=repeats,
        folder=store.folder,
        minutes=0.0,
        notes=_notes(measured, repeats),
    )


def _question(settings: Settings, env_config: EnvConfig) -> dict[str, Any]:
    """What finished episodes depend on, apart from what is changed and from their seeds."""
    return {
        "checkpoint": checkpoint_digest(settings.checkpoint),
        "environment": environment_identity(env_config),
        "version": version("lerobot_policy_act_chunking"),
    }


def _hopeless(seen: Seen) -> bool:
    """Whether the weights are the initial ones, which no other execution changes."""
    return any(each.name == "untrained" and each.found for each in seen.findings)


def _intervened(
    settings: Settings,
    executable: Executable,
    demonstrations: Demonstrations | None,
    seen: Seen,
    laboratory: Laboratory,
    measured: Measured,
) -> Measured:
    fps = None if demonstrations is None else demonstrations.fps
    trials = make_trials(
        executable,
        smoothing=smoothing_to_try(executable.config, fps),
        statistics=demonstrations.folder if demonstrations is not None and seen.statistics else None,
        later=later_checkpoint(settings.checkpoint),
    )
    noisy = draws_noise(executable.config)
    return intervene(laboratory, measured.records, trials, settings.most, noisy=noisy)


def _notes(measured: Measured, repeats: bool | None) -> list[str]:
    notes = []
    if measured.repetition is not None:
        rate = measured.repetition
        notes.append(
            f"Other noise alone repairs {rate.successes} of {rate.episodes} failures: a cause counts for "
            "what it repairs beyond that."
        )
    if measured.given_up:
        n = max(measured.given_up.values())
        notes.append(f"{len(measured.given_up)} interventions repaired none of the first {n} failures.")
    if repeats is False:
        notes.append("This environment does not repeat itself: interventions begin with the episode.")
    moments = measured.moments
    if moments is not None:
        for trial, found in moments.found.items():
            if found:
                notes.append(
                    f"From the last state that was still good, {trial.change} saves {sum(found.values())} of "
                    f"{len(found)} episodes."
                )
    if not measured.complete:
        notes.append("Time ended before all was tried: the same command goes on from here.")
    return notes
