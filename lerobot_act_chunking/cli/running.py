"""Runs a command line and answers with its exit status."""

import sys
from typing import Any

import typer
from rich.console import Console
from rich.markup import escape

from lerobot_act_chunking.errors import ActChunkingError

REFUSED = 1
STOPPED = 130  # what shells report after Ctrl-C


def run(app: Any, argv: list[str] | None = None, name: str | None = None) -> int:
    """Run a typer application: refusals and Ctrl-C become one line and an exit status.

    Args:
        app: the application.
        argv: its arguments; None for the process's own.
        name: what usage messages call it; None for the script's name.
    """
    console = Console(stderr=True)
    try:
        status = app(args=argv, prog_name=name, standalone_mode=False)
    except ActChunkingError as error:
        console.print(f"[red]error:[/] {escape(str(error))}", highlight=False, soft_wrap=True)
        return REFUSED
    except (KeyboardInterrupt, typer.Abort):
        status = STOPPED
    except Exception as error:
        if not hasattr(error, "exit_code"):
            raise
        _show_usage_error(error)
        return int(error.exit_code)  # pyright: ignore[reportAttributeAccessIssue]
    if status == STOPPED:  # typer may also return it, having caught Ctrl-C itself
        console.print("\nstopped; run the same command again to go on from here")
    return status if isinstance(status, int) else 0


def _show_usage_error(error: Exception) -> None:
    """Click's own errors know how to print themselves (``Exit`` has nothing to say)."""
    show = getattr(error, "show", None)
    if show is not None:
        show(file=sys.stderr)
