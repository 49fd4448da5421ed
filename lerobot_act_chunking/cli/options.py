"""Options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

OUT = ("--out", "--output")
"""What a command makes: a checkpoint, a file of codes, or a picture."""

Picture = Annotated[Path | None, typer.Option(*OUT, help="Draw a PNG.")]
