"""The whole diagnosis, from what is asked to the report."""

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from lerobot.envs.configs import EnvConfig

from lerobot_act_chunking.diagnostics.core.clock import Clock, Progress
from lerobot_act_chunking.diagnostics.core.digests import environment_identity
from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec, environment_of
from lerobot_act_chunking.diagnostics.core.executable import executable_digest
from lerobot_act_chunking.diagnostics.core.report import with_untrained
from lerobot_act_chunking.diagnostics.core.training import untrained
from lerobot_act_chunking.diagnostics.tune.candidates import Candidate
from lerobot_act_chunking.diagnostics.tune.measuring import CandidateCell, Episodes, make_runner
from lerobot_act_chunking.diagnostics.tune.racing import race
from lerobot_act_chunking.diagnostics.tune.replay import Replay, hold_out, replay
from lerobot_act_chunking.diagnostics.tune.report import TuneReport
from lerobot_act_chunking.diagnostics.tune.settings import Settings
from lerobot_act_chunking.diagnostics.tune.store import Store
from lerobot_act_chunking.diagnostics.tune.subject import Subject, read_subject
from lerobot_act_chunking.diagnostics.tune.verdict import TuneJudgement, judge_race, judge_replay
from lerobot_act_chunking.diagnostics.tune.writing import changes, check_writable, wrap_command, write
from lerobot_act_chunking.executors import each_done


def diagnose(settings: Settings, progress: Progress | None = None) -> TuneReport:
    """Try the executions that a checkpoint can have, and choose one; written only if that is asked.

    Args:
        settings: what is asked.
        progress: called with the numbers of episodes (candidates, of a dataset) done and planned so far.

    Raises:
        ConfigurationError: a checkpoint or an environment that cannot be used, an environment that says
            nothing of success, or nothing to write to.
        DatasetError: no usable dataset.
        FeatureError: the environment or dataset lacks what the policy observes.
    """
    started = time.monotonic()
    subject = read_subject(settings.checkpoint)
    if settings.write:
        check_writable(subject)
    clock = Clock(started + 60 * settings.minutes, progress)
    if settings.environment is None:
        report = _replayed(settings, subject, clock)
    else:
        report = _raced(settings, subject, settings.environment, clock)
    if settings.write and report.changes:
        write(settings.checkpoint, report.changes)
        report = replace(report, written=True)
    return replace(report, minutes=(time.monotonic() - started) / 60)


def _raced(settings: Settings, subject: Subject, environment: EnvironmentSpec, clock: Clock) -> TuneReport:
    env_config = environment_of(subject.config, environment, settings.checkpoint)
    policy = subject.load()
    store = Store(_question(settings, subject, env_config), settings.output_dir)
    episodes = Episodes(subject, env_config, settings.seed)
    with make_runner(episodes, settings.workers, policy, settings.cluster) as runner:
        evaluate = store.remembering(lambda cells: each_done(runner, cells, clock.may_begin))

        def counted(cells: Sequence[CandidateCell]) -> Any:
            clock.advance(planned=sum(cell.n for cell in cells))
            for cell, successes in evaluate(cells):
                clock.advance(done=cell.n)
                yield cell, successes

        found = race(subject.candidates, counted, settings.episodes)
    judgement = judge_race(found, lambda each: each.calls_per_second(env_config.fps))
    return _report(
        settings,
        subject,
        with_untrained(judgement, untrained(settings.checkpoint)),
        where=environment.name,
        fps=env_config.fps,
        race=found,
        folder=store.folder,
    )


def _question(settings: Settings, subject: Subject, env_config: EnvConfig) -> dict[str, Any]:
    """What finished episodes depend on, apart from the candidate and the number of the episode."""
    return {
        "checkpoint": executable_digest(subject),
        "environment": environment_identity(env_config),
        "seed": settings.seed,
    }


def _replayed(settings: Settings, subject: Subject, clock: Clock) -> TuneReport:
    folder = settings.dataset or ""
    held_out = hold_out(folder, settings.checkpoint, subject.config, settings.episodes)
    found: dict[Candidate, Replay] = {}
    policy = subject.load()
    clock.advance(planned=len(subject.candidates))
    for candidate in subject.candidates:
        if not clock.may_begin():
            break
        found[candidate] = replay(policy, candidate, held_out)
        clock.advance(done=1)
    fps = held_out.demonstrated.fps
    judgement = judge_replay(subject.candidates, found, lambda each: each.calls_per_second(fps))
    return _report(
        settings,
        subject,
        with_untrained(judgement, untrained(settings.checkpoint)),
        where=folder,
        fps=fps,
        replays=found,
        seen_in_training=held_out.seen_in_training,
    )


def _report(settings: Settings, subject: Subject, judgement: TuneJudgement, **measured: Any) -> TuneReport:
    chosen = judgement.chosen
    made = changes(subject, chosen)
    return TuneReport(
        requested=settings,
        policy_type=subject.policy_type,
        candidates=subject.candidates,
        judgement=judgement,
        changes=made,
        wrap=wrap_command(subject, chosen) if subject.wrapped and made else None,
        minutes=0.0,
        **measured,
    )
