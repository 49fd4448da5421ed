"""``act-chunking check``: may this checkpoint act on this robot?"""

from typing import Annotated

import typer

from lerobot_act_chunking.cli.environment import EnvironmentCommand
from lerobot_act_chunking.cli.options import Json
from lerobot_act_chunking.cli.reporting import finish


class RobotCommand(EnvironmentCommand):
    """A command whose ``--robot.FIELD`` come to it as ``FIELD=VALUE``."""

    prefix = "--robot."


def check_command(
    checkpoint: Annotated[str, typer.Argument(help="Checkpoint folder (…/pretrained_model) or repo id.")],
    robot: Annotated[
        list[str] | None,
        typer.Option(
            "--robot.type",
            "--robot.FIELD",
            metavar="VALUE",
            help="Any robot that LeRobot can make, and any field of its configuration, as lerobot-rollout "
            "takes them.",
        ),
    ] = None,
    dataset: Annotated[
        str | None, typer.Option(help="Folder of recordings of the robot; the policy acts on one of them.")
    ] = None,
    fps: Annotated[
        float | None, typer.Option(help="Control steps a second. \\[default: those of the training]")
    ] = None,
    connect: Annotated[
        bool, typer.Option("--connect", help="Connect the robot and read one observation; nothing is sent.")
    ] = False,
    seconds: Annotated[float, typer.Option(help="How long it acts on the recording.")] = 5.0,
    rename_map: Annotated[
        str | None,
        typer.Option(
            "--rename_map",
            help="As of lerobot-rollout, what the robot calls otherwise than the policy: "
            "'{observation.images.top: observation.images.front}'.",
        ),
    ] = None,
    json: Json = None,
) -> None:
    """Whether a checkpoint fits a robot or its recordings, and how it can act in time, before the arm moves.

    Exit status: 0 it fits, or look at what is said; 11 do not let it act as it is.
    """
    from lerobot_act_chunking.diagnostics.check import Settings, diagnose, print_report

    renamed = _names(rename_map) if rename_map else {}
    settings = Settings(checkpoint, tuple(robot or ()), dataset, fps, connect, seconds, renamed)
    finish(diagnose(settings), print_report, json=json)


def _names(text: str) -> dict[str, str]:
    """A mapping of names, spelled as LeRobot's commands take it."""
    import yaml

    from lerobot_act_chunking.errors import ConfigurationError

    try:
        names = yaml.safe_load(text)
    except yaml.YAMLError:
        names = None
    if not isinstance(names, dict) or not all(isinstance(each, str) for each in (*names, *names.values())):
        raise ConfigurationError(
            f"--rename_map={text} is no mapping of names: write '{{<the robot's>: <the policy's>}}'"
        )
    return names
