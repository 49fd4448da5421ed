"""``act-chunking eval``: how often do policies succeed, and what goes wrong?"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.console import Console

from lerobot_act_chunking.cli.environment import Fields, Success, SuccessKey, Task, asked_environment
from lerobot_act_chunking.cli.options import (
    Address,
    Executor,
    Json,
    Picture,
    Workers,
    asked_workers,
    to_a_folder,
)
from lerobot_act_chunking.cli.progress import shown
from lerobot_act_chunking.cli.reporting import finish

if TYPE_CHECKING:
    from lerobot_act_chunking.diagnostics.compare.report import CompareReport
    from lerobot_act_chunking.diagnostics.eval.report import EvalReport


def eval_command(
    policies: Annotated[
        list[str],
        typer.Argument(
            metavar="[NAME=]CHECKPOINT[,CHECKPOINT...]",
            help="A policy by its checkpoint folder (…/pretrained_model) or repo id; several training seeds "
            "of it with commas between them. Several policies are compared.",
        ),
    ],
    env: Fields = None,
    task: Task = None,
    success: Success = None,
    success_key: SuccessKey = None,
    episodes: Annotated[int, typer.Option(help="Of each checkpoint; with --until=decided the most.")] = 200,
    seed: Annotated[int, typer.Option(help="Of the first episode.")] = 1000,
    batch_size: Annotated[
        int, typer.Option(help="Episodes that act together, as --eval.batch_size of lerobot-eval.")
    ] = 25,
    draws: Annotated[
        int, typer.Option(help="Repeat every episode so often, each time with other noise of the policy.")
    ] = 1,
    until: Annotated[
        Literal["done", "decided"],
        typer.Option(help="decided: stop as soon as it is known which policy is best."),
    ] = "done",
    workers: Workers = None,
    executor: Executor = "local",
    address: Address = None,
    shard: Annotated[
        str, typer.Option(metavar="I/N", help="Run the I-th of N parts, as 1/4, for several machines.")
    ] = "1/1",
    merge: Annotated[
        list[Path] | None,
        typer.Option(help="Take over the episodes of another --output-dir; may be repeated."),
    ] = None,
    videos: Annotated[
        int, typer.Option(help="Films of so many episodes of each checkpoint, failures first.")
    ] = 0,
    output_dir: Annotated[
        Path | None,
        typer.Option(
            callback=to_a_folder,
            help="Where everything is kept. \\[default: outputs/eval/..., by what is asked]",
        ),
    ] = None,
    json: Json = None,
    out: Picture = None,
) -> None:
    """Evaluate checkpoints of any LeRobot policy in any environment, with the reasons of their failures.

    Acts as lerobot-eval does and writes its eval_info.json, and a report.html for the browser. Stop it
    whenever you like: the same command goes on where it was. Exit status: 0 done, 10 not decided.
    """
    from lerobot_act_chunking.diagnostics.compare.terminal import print_report as print_comparison
    from lerobot_act_chunking.diagnostics.eval.diagnosis import diagnose
    from lerobot_act_chunking.diagnostics.eval.page import write_page
    from lerobot_act_chunking.diagnostics.eval.plots import plot_report
    from lerobot_act_chunking.diagnostics.eval.settings import Settings, parse_policy, parse_shard
    from lerobot_act_chunking.diagnostics.eval.terminal import print_report
    from lerobot_act_chunking.errors import ConfigurationError

    environment = asked_environment(env, task, success, success_key=success_key)
    if environment is None:
        raise ConfigurationError(
            "eval acts in an environment: give --env.type (of LeRobot or a plug-in), or --task (as insertion)"
        )
    n_workers, cluster = asked_workers(workers, executor, address)
    settings = Settings(
        recipes=tuple(map(parse_policy, policies)),
        environment=environment,
        episodes=episodes,
        seed=seed,
        batch_size=batch_size,
        draws=draws,
        workers=n_workers,
        cluster=cluster,
        output_dir=output_dir,
        shard=parse_shard(shard),
        merge=tuple(merge or ()),
        until_decided=until == "decided",
        videos=videos,
    )
    with shown("running episodes") as progress:
        report = diagnose(settings, progress)
    comparison = _compared(report)
    page = write_page(report, comparison and comparison.to_json())

    def show(report: "EvalReport", console: Console) -> None:
        print_report(report, console)
        if comparison is not None:
            console.print()
            print_comparison(comparison, console)

    finish(report, show, plot_report, json=json, picture=out, made=[f"page: {page}"])


def _compared(report: "EvalReport") -> "CompareReport | None":
    """The policies side by side, by the first draw of each; None of one, or if success is unknown."""
    from lerobot_act_chunking.diagnostics.compare.diagnosis import diagnose
    from lerobot_act_chunking.diagnostics.compare.settings import Settings

    recipes = report.recipes
    return diagnose(Settings(recipes)) if len(recipes) > 1 and report.is_judged else None
