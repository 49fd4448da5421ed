"""Outcomes of episodes on the disk, so that a measurement can be stopped and gone on with."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lerobot_act_chunking.diagnostics.core.digests import question_digest
from lerobot_act_chunking.durable_files import write_atomically
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.json_files import read_json

FILE = "episodes.json"


class Outcomes:
    """Which episodes succeeded, by what was run, in one file that is written whole after each.

    Args:
        question: what they depend on apart from the key: the checkpoint, the environment, the first seed.
        folder: of the file; by default one in ``parent`` that follows from the question.
        parent: of all such folders.

    Raises:
        ConfigurationError: the folder holds the episodes of another question, or its file is damaged.
    """

    def __init__(self, question: dict[str, Any], folder: Path | None, parent: Path) -> None:
        self.folder = folder or parent / question_digest(question)
        self._question = json.loads(json.dumps(question))
        self._outcomes = self._read()

    def _read(self) -> dict[str, str]:
        file = self.folder / FILE
        if not file.exists():
            return {}
        try:
            content = read_json(file)
            question, outcomes = dict(content["question"]), dict[str, str](content["outcomes"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ConfigurationError(
                f"{file} cannot be read ({error!r}): remove it, or choose another --output-dir"
            ) from error
        differing = [name for name in self._question if question.get(name) != self._question[name]]
        if differing:
            raise ConfigurationError(
                f"{file} holds episodes of another {' and '.join(differing)}: choose another --output-dir"
            )
        return outcomes

    def get(self, key: str) -> list[bool] | None:
        """The outcome of what is called so, if it is here."""
        found = self._outcomes.get(key)
        return None if found is None else [each == "1" for each in found]

    def put(self, key: str, successes: Sequence[bool]) -> None:
        """Keep an outcome."""
        self._outcomes[key] = "".join("01"[bool(each)] for each in successes)
        content = {"question": self._question, "outcomes": self._outcomes}
        write_atomically(self.folder / FILE, (json.dumps(content, indent=1) + "\n").encode())
