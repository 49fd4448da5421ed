"""``act-chunking resolution``: how far apart in time may a policy's predictions lie?"""

from typing import Annotated

import typer

from lerobot_act_chunking.cli.options import Json, Picture, parse_numbers
from lerobot_act_chunking.cli.progress import shown
from lerobot_act_chunking.cli.reporting import finish


def resolution_command(
    dataset: Annotated[str, typer.Argument(help="A LeRobotDataset's folder.")],
    horizon_s: Annotated[float, typer.Option(help="Time that a chunk covers, in s.")] = 2.0,
    strides: Annotated[
        str | None,
        typer.Option(help="Control steps between predictions to try, such as 2,5,10; default: 1 to 50."),
    ] = None,
    chunk_stride: Annotated[
        int | None, typer.Option(help="The one you have in mind: fails if it is too coarse.")
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="What actions may be off in 95 % of the steps: mm for ALOHA (default 0.5), else a share of "
            "each dimension's range (default 0.01)."
        ),
    ] = None,
    gripper_dims: Annotated[
        str | None, typer.Option(help="Dimensions that the policy holds between predictions, such as 6,13.")
    ] = None,
    json: Json = None,
    out: Picture = None,
) -> None:
    """What demonstrations lose when only every n-th action is predicted and the others are interpolated.

    Only actions are read, never images. Exit status: 0 fine or to be looked at, 11 too coarse, 10 cannot
    be judged.
    """
    from lerobot_act_chunking.diagnostics.resolution.diagnosis import diagnose
    from lerobot_act_chunking.diagnostics.resolution.plots import plot_report
    from lerobot_act_chunking.diagnostics.resolution.settings import Criteria, Settings
    from lerobot_act_chunking.diagnostics.resolution.terminal import print_report

    criteria = Criteria(
        horizon_s=horizon_s,
        strides=parse_numbers("strides", strides or None),
        chunk_stride=chunk_stride,
        tolerance=tolerance,
        gripper_dims=parse_numbers("gripper_dims", gripper_dims or None),
    )
    settings = Settings(dataset, criteria)
    with shown("interpolating demonstrations"):
        report = diagnose(settings)
    finish(report, print_report, plot_report, json=json, picture=out)
