"""``act-chunking resolution``: how far apart in time may a policy's predictions lie?"""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from lerobot_act_chunking.cli.options import Picture
from lerobot_act_chunking.cli.progress import shown


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
    json: Annotated[Path | None, typer.Option(help="Write every number to this file.")] = None,
    out: Picture = None,
) -> None:
    """What demonstrations lose when only every n-th action is predicted and the others are interpolated.

    Only actions are read, never images. Exit status: 0 fine or to be looked at, 11 too coarse, 10 cannot
    be judged.
    """
    from lerobot_act_chunking.data.actions import is_dataset
    from lerobot_act_chunking.diagnostics.core.episodes import read_episodes
    from lerobot_act_chunking.diagnostics.resolution.card import print_card
    from lerobot_act_chunking.diagnostics.resolution.plots import plot_report
    from lerobot_act_chunking.diagnostics.resolution.report import Question, diagnose
    from lerobot_act_chunking.errors import DatasetError

    if not is_dataset(dataset):
        raise DatasetError(f"there is no LeRobotDataset at {dataset}: give its folder (with meta/info.json)")
    question = Question(
        horizon_s=horizon_s,
        strides=_numbers("strides", strides),
        chunk_stride=chunk_stride,
        tolerance=tolerance,
        gripper_dims=_numbers("gripper_dims", gripper_dims),
    )
    with shown("interpolating demonstrations"):
        report = diagnose(read_episodes(dataset), question)
    written = []  # before printing, which a closed pipe may end
    if json is not None:
        written.append(f"numbers: {report.write_json(json)}")
    if out is not None:
        written.append(f"picture: {plot_report(report, out)}")
    console = Console()
    print_card(report, console)
    for line in written:
        console.print(line, soft_wrap=True)
    raise typer.Exit(report.exit_code)


def _numbers(name: str, text: str | None) -> tuple[int, ...]:
    from lerobot_act_chunking.errors import ConfigurationError

    try:
        return tuple(int(part) for part in text.split(",")) if text else ()
    except ValueError:
        raise ConfigurationError(
            f"{name}={text!r} must be numbers with commas between them: 2,5,10"
        ) from None
