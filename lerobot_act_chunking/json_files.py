"""Reading JSON that anybody may have damaged."""

import json
from pathlib import Path
from typing import Any


def read_json(path: Path) -> Any:
    """The content of a JSON file.

    Raises:
        ValueError: it is no JSON, or lists lie in each other too deeply to be read.
        OSError: there is no such file, or it may not be read.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except RecursionError as error:
        raise ValueError("values lie in each other too deeply") from error
