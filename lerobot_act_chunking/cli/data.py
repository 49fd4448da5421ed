"""``act-chunking data``: what is a dataset like, before anything is trained on it?"""

from typing import Annotated

import typer

from lerobot_act_chunking.cli.options import Json, Picture
from lerobot_act_chunking.cli.progress import shown
from lerobot_act_chunking.cli.reporting import finish


def data_command(
    dataset: Annotated[str, typer.Argument(help="A LeRobotDataset's folder.")],
    cameras: Annotated[
        str, typer.Option(help="How much of the cameras to decode: none, sample (some episodes), all.")
    ] = "sample",
    operator_column: Annotated[
        str | None,
        typer.Option(help="Column that says who demonstrates; default: the usual names are looked for."),
    ] = None,
    json: Json = None,
    out: Picture = None,
) -> None:
    """What demonstrations are like: rests, pace, jumps, lags, ways, clocks and cameras, and what to change.

    Exit status: 0 fine or to be looked at, 11 training on it makes no sense as it is, 10 cannot be judged.
    """
    from lerobot_act_chunking.diagnostics.data.diagnosis import diagnose
    from lerobot_act_chunking.diagnostics.data.plots import plot_report
    from lerobot_act_chunking.diagnostics.data.settings import Settings
    from lerobot_act_chunking.diagnostics.data.terminal import print_report

    settings = Settings(dataset, cameras, operator_column)
    with shown("looking at demonstrations") as progress:
        report = diagnose(settings, progress)
    finish(report, print_report, plot_report, json=json, picture=out)
