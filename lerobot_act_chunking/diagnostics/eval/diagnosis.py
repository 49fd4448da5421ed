"""The whole evaluation, from what is asked to the report."""

import os
import platform
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from lerobot_act_chunking.diagnostics.core.digests import (
    checkpoint_digest,
    dataset_digest,
    environment_identity,
    question_digest,
)
from lerobot_act_chunking.diagnostics.core.report import with_untrained
from lerobot_act_chunking.diagnostics.core.success_keys import never_said
from lerobot_act_chunking.diagnostics.core.training import read_training, untrained
from lerobot_act_chunking.diagnostics.eval.films import choose, film
from lerobot_act_chunking.diagnostics.eval.measuring import Results, measure
from lerobot_act_chunking.diagnostics.eval.playing import Stage
from lerobot_act_chunking.diagnostics.eval.report import EvalReport, RunResult
from lerobot_act_chunking.diagnostics.eval.runs import QUESTION, Run
from lerobot_act_chunking.diagnostics.eval.settings import Settings
from lerobot_act_chunking.diagnostics.eval.subject import Subject, read_subject
from lerobot_act_chunking.diagnostics.eval.verdict import judge
from lerobot_act_chunking.errors import ConfigurationError

DEFAULT_PARENT, FILMS = Path("outputs/eval"), "films"
PACKAGES = ("lerobot_policy_act_chunking", "lerobot", "torch", "numpy", "mujoco", "gymnasium")
Progress = Callable[[int, int], None]


def diagnose(settings: Settings, progress: Progress | None = None) -> EvalReport:
    """How often do policies succeed, and what goes wrong?

    Args:
        settings: what is asked.
        progress: called with the numbers of episodes done and planned.

    Raises:
        ConfigurationError: a checkpoint, an environment or a folder that cannot be used.
        FeatureError: the environment lacks what a policy observes.
    """
    subjects = {
        place: read_subject(place, settings.environment) for each in settings.recipes for place in each.places
    }
    runs, folder = _runs(settings, subjects)
    _check_merge(runs, settings.merge)
    for run in runs:
        for other in settings.merge:
            run.take_over(other / run.place)
        run.open()
    stage = Stage(subjects, settings.seed, settings.batch_size)
    found, decision = measure(
        runs,
        stage,
        settings.groups,
        episodes=settings.episodes,
        workers=settings.workers,
        cluster=settings.cluster,
        until_decided=settings.until_decided,
        progress=progress,
    )
    results = [_result(run, found, subjects[run.checkpoint], settings.videos) for run in runs]
    unknown = _never_said(results, subjects)
    results = [replace(each, is_judged=unknown is None) for each in results]
    complete = settings.shard.of == 1
    machine = _machine()
    for each in results:
        facts = {"complete": complete, "machine": machine, "dataset": each.dataset}
        each.run.write_eval_info(each.episodes, facts, is_judged=each.is_judged)
    judgement = judge(results, decision, unknown)
    for place in subjects:
        judgement = with_untrained(judgement, untrained(place))
    return EvalReport(
        judgement=judgement,
        requested=settings,
        results=results,
        decision=decision,
        machine=machine,
        folder=folder,
        complete=complete,
        notes=_notes(settings, results),
    )


def _check_merge(runs: list[Run], others: tuple[Path, ...]) -> None:
    for other in others:
        if not any((other / run.place / QUESTION).is_file() for run in runs):
            places = ", ".join(str(run.place) for run in runs)
            raise ConfigurationError(
                f"--merge={other} holds no evaluation of {places}: give the --output-dir of the same command "
                "with another --shard"
            )


def _runs(settings: Settings, subjects: dict[str, Subject]) -> tuple[list[Run], Path]:
    """Every checkpoint with every draw of its noise, each with a folder of its own, and the folder of all."""
    runs = [
        Run(
            name=recipe.name,
            training=training if len(recipe.places) > 1 else None,
            draw=draw if settings.draws > 1 else None,
            checkpoint=place,
            policy_type=subjects[place].config.type,
            question={
                "checkpoint": checkpoint_digest(place),
                "environment": environment_identity(subjects[place].env_config),
                "seed": settings.seed,
                "batch_size": settings.batch_size,
                "draw": draw,
                "version": version(PACKAGES[0]),
            },
            folder=Path(),
        )
        for recipe in settings.recipes
        for training, place in enumerate(recipe.places)
        for draw in range(settings.draws)
    ]
    parent = settings.output_dir or DEFAULT_PARENT / question_digest(
        {run.title: run.question for run in runs}
    )
    return [replace(run, folder=parent / run.place) for run in runs], parent


def _result(run: Run, found: Results, subject: Subject, videos: int) -> RunResult:
    folder = read_training(run.checkpoint, subject.config).folder
    result = RunResult(
        run,
        found.of(run),
        found.groups[run.title],
        subject.dt,
        subject.action_names,
        None if folder is None else {"folder": folder, "sha256": dataset_digest(folder)},
    )
    chosen = [(result.episodes[place], result.commands(place)) for place in choose(result.episodes, videos)]
    films = film(subject.env_config, subject.config, chosen, run.folder / FILMS) if chosen else ()
    return replace(result, films=films)


def _never_said(results: list[RunResult], subjects: dict[str, Subject]) -> str | None:
    """That the environment, which is one for all, says nothing of success."""
    env_config = subjects[results[0].run.checkpoint].env_config
    return never_said(env_config, [each.instead for result in results for each in result.episodes])


def _machine() -> dict[str, Any]:
    return {
        "system": platform.platform(),
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "packages": {name: version(name) for name in PACKAGES},
    }


def _notes(settings: Settings, results: list[RunResult]) -> list[str]:
    notes = []
    if settings.shard.of > 1:
        notes.append(
            f"Part {settings.shard.number} of {settings.shard.of}: --merge of all parts gives the whole."
        )
    by_training: dict[tuple[str, int | None], list[RunResult]] = {}
    for each in results:
        by_training.setdefault((each.run.name, each.run.training), []).append(each)
    notes += [
        f"The film of {each.run.title}, seed {one.episode.seed}, ends otherwise than the episode: this "
        "environment does not repeat itself."
        for each in results
        for one in each.films
        if not one.faithful
    ]
    if settings.draws > 1:
        alike = [draws[0].run.name for draws in by_training.values() if _alike(draws)]
        notes += [f"All draws of {name} are the same: it draws no noise when it acts." for name in alike]
    return notes


def _alike(draws: list[RunResult]) -> bool:
    return all(each.episodes == draws[0].episodes for each in draws)
