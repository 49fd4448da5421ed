"""``act-chunking diagnose``: why does a policy fail, and what should change?"""

import os
from pathlib import Path
from typing import Annotated

import typer

from lerobot_act_chunking.cli.environment import Fields, Success, SuccessKey, Task, asked_environment
from lerobot_act_chunking.cli.options import Json, Picture, to_a_folder
from lerobot_act_chunking.cli.progress import shown
from lerobot_act_chunking.cli.reporting import finish


def diagnose_command(
    checkpoint: Annotated[str, typer.Argument(help="Checkpoint folder (…/pretrained_model) or repo id.")],
    env: Fields = None,
    task: Task = None,
    success: Success = None,
    success_key: SuccessKey = None,
    dataset: Annotated[
        str | None,
        typer.Option(
            help="Folder of the demonstrations; alone, without a simulation, it tells less. \\[default: "
            "those of the training, if they are here]"
        ),
    ] = None,
    episodes: Annotated[int, typer.Option(help="Of the policy as it is.")] = 100,
    most: Annotated[
        int, typer.Option(help="Failing episodes to intervene on; three times as many succeeding ones.")
    ] = 40,
    minutes: Annotated[float, typer.Option(help="No episodes are begun after this time.")] = 20.0,
    seed: Annotated[int, typer.Option(help="Of the first episode.")] = 1000,
    batch_size: Annotated[int, typer.Option(help="Episodes that act together.")] = 25,
    workers: Annotated[
        int | None, typer.Option(help="Processes that run episodes. \\[default: 2, or 1 on one core]")
    ] = None,
    output_dir: Annotated[
        Path | None,
        typer.Option(
            callback=to_a_folder,
            help="Where finished episodes are kept. \\[default: outputs/diagnose/..., by what is asked]",
        ),
    ] = None,
    json: Json = None,
    out: Picture = None,
) -> None:
    """Say why a policy fails, by what can be seen and by changing one thing at a time on the same episodes.

    Stop it whenever you like: the same command goes on where it was. Exit status: 0 healthy, 11 a cause is
    named, 10 cannot be told.
    """
    from lerobot_act_chunking.diagnostics.diagnose.diagnosis import diagnose
    from lerobot_act_chunking.diagnostics.diagnose.plots import plot_report
    from lerobot_act_chunking.diagnostics.diagnose.settings import Settings
    from lerobot_act_chunking.diagnostics.diagnose.terminal import print_report

    settings = Settings(
        checkpoint=checkpoint,
        environment=asked_environment(env, task, success, success_key=success_key),
        dataset=dataset,
        episodes=episodes,
        most=most,
        minutes=minutes,
        seed=seed,
        batch_size=batch_size,
        workers=workers if workers is not None else min(2, os.cpu_count() or 1),
        output_dir=output_dir,
    )
    with shown("failing, and failing otherwise") as progress:
        report = diagnose(settings, progress)
    finish(report, print_report, plot_report, json=json, picture=out)
