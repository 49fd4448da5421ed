"""How every command of an instrument ends."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import typer
from rich.console import Console

if TYPE_CHECKING:
    from lerobot_act_chunking.diagnostics.core.report import Report


def finish[R: Report](
    report: R,
    show: Callable[[R, Console], None],
    draw: Callable[[R, Path], Path] | None = None,
    *,
    json: Path | None,
    picture: Path | None = None,
    made: Sequence[str] = (),
) -> NoReturn:
    """Write a report's files, print it, and exit with its status.

    Files come first: a closed pipe may end the command while it prints.

    Args:
        report: of any instrument.
        show: prints it.
        draw: makes a PNG of it, and returns its path; None where the instrument has no picture.
        json: where its numbers go, if anywhere.
        picture: where the PNG goes, if anywhere.
        made: lines on what else the command has made.

    Raises:
        typer.Exit: always.
    """
    written = [*made]
    if json is not None:
        written.append(f"numbers: {report.write(json)}")
    if draw is not None and picture is not None:
        written.append(f"picture: {draw(report, picture)}")
    console = Console()
    show(report, console)
    for line in written:
        console.print(line, soft_wrap=True)
    raise typer.Exit(report.exit_code)
