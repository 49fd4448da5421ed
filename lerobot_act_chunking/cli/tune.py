"""``act-chunking tune``: which execution suits a trained policy, found by measurement."""

from pathlib import Path
from typing import Annotated

import typer

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


def tune_command(
    checkpoint: Annotated[str, typer.Argument(help="Checkpoint folder (…/pretrained_model) or repo id.")],
    env: Fields = None,
    task: Task = None,
    success: Success = None,
    success_key: SuccessKey = None,
    dataset: Annotated[
        str | None, typer.Option(help="Without a simulation: folder of a LeRobotDataset to replay. Weaker.")
    ] = None,
    episodes: Annotated[
        int | None,
        typer.Option(help="Most per candidate; of a dataset, how many to hold out. \\[default: 100; 10]"),
    ] = None,
    minutes: Annotated[float, typer.Option(help="No episodes are begun after this time.")] = 5.0,
    seed: Annotated[
        int, typer.Option(help="Of the first episode; keep away from those that you evaluate on.")
    ] = 100_000,
    workers: Workers = None,
    executor: Executor = "local",
    address: Address = None,
    output_dir: Annotated[
        Path | None,
        typer.Option(
            callback=to_a_folder,
            help="Where finished episodes are kept. \\[default: outputs/tune/..., by what is asked]",
        ),
    ] = None,
    write: Annotated[
        bool, typer.Option("--write", help="Change the checkpoint's configuration to the choice.")
    ] = False,
    json: Json = None,
    out: Picture = None,
) -> None:
    """Try the ways of executing a policy's chunks against each other, and say which to use.

    Stop it whenever you like: the same command goes on where it was. Exit status: 0 done, 10 cannot be told.
    """
    from lerobot_act_chunking.diagnostics.tune.diagnosis import diagnose
    from lerobot_act_chunking.diagnostics.tune.plots import plot_report
    from lerobot_act_chunking.diagnostics.tune.settings import Settings
    from lerobot_act_chunking.diagnostics.tune.terminal import print_report

    n_workers, cluster = asked_workers(workers, executor, address)
    settings = Settings(
        checkpoint=checkpoint,
        environment=asked_environment(env, task, success, success_key=success_key),
        dataset=dataset,
        episodes=episodes if episodes is not None else 10 if dataset is not None else 100,
        minutes=minutes,
        seed=seed,
        workers=n_workers,
        cluster=cluster,
        output_dir=output_dir,
        write=write,
    )
    with shown("executing in many ways") as progress:
        report = diagnose(settings, progress)
    finish(report, print_report, plot_report, json=json, picture=out)
