"""``act-chunking import``: a checkpoint of LeRobot's act, of any version, becomes one of act_chunked."""

from pathlib import Path
from typing import Annotated

import typer

from lerobot_act_chunking.cli.options import OUT


def import_command(
    checkpoint: Annotated[Path, typer.Argument(help="Folder of a LeRobot act policy (…/pretrained_model).")],
    out: Annotated[Path, typer.Option(*OUT, help="The folder to write; must not exist.")],
    dataset: Annotated[
        Path | None,
        typer.Option(help="Folder of the dataset it learned from, if it holds no statistics of its own."),
    ] = None,
) -> None:
    """Import a checkpoint of LeRobot's act, also one from before LeRobot had processors.

    The new policy acts exactly as the old one, and may be executed and trained in act_chunked's other ways.
    """
    from rich.console import Console

    from lerobot_act_chunking.policies.act_chunked.importing.conversion import import_checkpoint

    imported = import_checkpoint(checkpoint, out, dataset)
    settings = imported.loaded.policy.config.execution_settings
    for line in (
        f"imported: chunks of {settings.chunk_size} control steps; execution={settings.execution}, a new "
        f"chunk every {settings.replan_interval} steps",
        f"compared with LeRobot's: normalised actions for a random batch differ by {imported.difference:.1e}",
        f"checkpoint: {out}",
        f"evaluate it: lerobot-eval --policy.path={out} --env.type=<type>",
    ):
        Console().print(line, soft_wrap=True, highlight=False)
