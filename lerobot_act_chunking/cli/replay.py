"""``act-chunking replay``: what would a policy do where the demonstrators were?"""

from typing import Annotated

import typer

from lerobot_act_chunking.cli.options import Json, Picture, parse_numbers
from lerobot_act_chunking.cli.progress import shown
from lerobot_act_chunking.cli.reporting import finish


def replay_command(
    checkpoint: Annotated[
        str, typer.Argument(help="Of any LeRobot policy: folder (…/pretrained_model) or repo id.")
    ],
    dataset: Annotated[str, typer.Argument(help="A LeRobotDataset's folder, of the same robot.")],
    episodes: Annotated[
        str | None,
        typer.Option(help="To replay, as 40,41,42; default: at most 20 that training did not use."),
    ] = None,
    observations: Annotated[
        int, typer.Option(help="At which the policy is asked for a whole chunk, spread over the episodes.")
    ] = 200,
    seed: Annotated[int, typer.Option(help="Of the resampling behind intervals.")] = 0,
    json: Json = None,
    out: Picture = None,
) -> None:
    """A policy against demonstrations, before the robot moves: its chunks, grippers and rests; no simulation.

    Exit status: 0 it does what was demonstrated, or something is to be looked at, 11 it does not, 10 cannot
    be judged.
    """
    from lerobot_act_chunking.diagnostics.replay.diagnosis import diagnose
    from lerobot_act_chunking.diagnostics.replay.plots import plot_report
    from lerobot_act_chunking.diagnostics.replay.settings import Settings
    from lerobot_act_chunking.diagnostics.replay.terminal import print_report

    settings = Settings(
        checkpoint=checkpoint,
        dataset=dataset,
        episodes=parse_numbers("episodes", episodes, "40,41,42"),
        observations=observations,
        seed=seed,
    )
    with shown("asking the policy where demonstrators were"):
        report = diagnose(settings)
    finish(report, print_report, plot_report, json=json, picture=out)
