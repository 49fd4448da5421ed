"""``act-chunking modes``: does a policy take the ways that were demonstrated, as often; if not, why?"""

from typing import Annotated

import typer

from lerobot_act_chunking.cli.environment import Fields, Success, SuccessKey, Task, asked_environment
from lerobot_act_chunking.cli.options import Address, Executor, Json, Picture, Workers, asked_workers
from lerobot_act_chunking.cli.progress import shown
from lerobot_act_chunking.cli.reporting import finish


def modes_command(
    checkpoint: Annotated[
        str, typer.Argument(help="Of any LeRobot policy: folder (…/pretrained_model) or repo id.")
    ],
    env: Fields = None,
    task: Task = None,
    success: Success = None,
    success_key: SuccessKey = None,
    dataset: Annotated[
        str | None,
        typer.Option(help="Folder of the demonstrations; default: those the checkpoint was trained on."),
    ] = None,
    shares: Annotated[
        str | None,
        typer.Option(help="Percentages of the demonstrations, as 80,15,5; default: those of the dataset."),
    ] = None,
    episodes: Annotated[int, typer.Option(help="To run.")] = 200,
    samples: Annotated[int, typer.Option(help="Chunks to sample at each start.")] = 16,
    seed: Annotated[int, typer.Option(help="Of the first episode, and of all else that is random.")] = 20_000,
    batch_size: Annotated[int, typer.Option(help="Episodes that act together.")] = 50,
    workers: Workers = None,
    executor: Executor = "local",
    address: Address = None,
    json: Json = None,
    out: Picture = None,
) -> None:
    """Does a policy take all demonstrated ways of doing the task, as often; if not, why, and what repairs it?

    Exit status: 0 all ways are taken and hardly any episode goes none of them, 11 not so, 10 too few
    episodes, or no ways are known.
    """
    from lerobot_act_chunking.diagnostics.modes.diagnosis import diagnose
    from lerobot_act_chunking.diagnostics.modes.plots import plot_report
    from lerobot_act_chunking.diagnostics.modes.settings import Settings, parse_shares
    from lerobot_act_chunking.diagnostics.modes.terminal import print_report
    from lerobot_act_chunking.errors import ConfigurationError

    environment = asked_environment(env, task, success, success_key=success_key)
    if environment is None:
        raise ConfigurationError(
            "modes acts in an environment: give --env.type, as three_gates, or --task, as transfer_modes"
        )
    n_workers, cluster = asked_workers(workers, executor, address)
    settings = Settings(
        checkpoint=checkpoint,
        environment=environment,
        dataset=dataset,
        shares=parse_shares(shares),
        episodes=episodes,
        samples=samples,
        seed=seed,
        batch_size=batch_size,
        workers=n_workers,
        cluster=cluster,
    )
    with shown("running episodes") as progress:
        report = diagnose(settings, progress)
    finish(report, print_report, plot_report, json=json, picture=out)
