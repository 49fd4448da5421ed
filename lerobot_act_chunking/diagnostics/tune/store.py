"""Finished episodes on the disk, so that a race can be stopped and gone on with."""

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from lerobot_act_chunking.diagnostics.core.digests import question_digest
from lerobot_act_chunking.diagnostics.tune.measuring import CandidateCell, Outcome
from lerobot_act_chunking.durable_files import write_atomically
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.json_files import read_json

FILE = "episodes.json"
DEFAULT_PARENT = Path("outputs/tune")


class Store:
    """The outcomes of cells, in one file that is written whole after each.

    Args:
        question: what they depend on apart from the cell: the checkpoint, the environment, the first seed.
        folder: of the file; by default one that follows from the question.

    Raises:
        ConfigurationError: the folder holds the episodes of another question, or its file is damaged.
    """

    def __init__(self, question: dict[str, Any], folder: Path | None) -> None:
        self.folder = folder or DEFAULT_PARENT / question_digest(question)
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

    def get(self, cell: CandidateCell) -> list[bool] | None:
        """A cell's outcome, if it is here."""
        found = self._outcomes.get(_key(cell))
        return None if found is None else [each == "1" for each in found]

    def put(self, cell: CandidateCell, successes: Sequence[bool]) -> None:
        """Keep a cell's outcome."""
        self._outcomes[_key(cell)] = "".join("01"[bool(each)] for each in successes)
        content = {"question": self._question, "outcomes": self._outcomes}
        write_atomically(self.folder / FILE, (json.dumps(content, indent=1) + "\n").encode())

    def remembering(
        self, run: Callable[[Sequence[CandidateCell]], Iterator[Outcome]]
    ) -> Callable[[Sequence[CandidateCell]], Iterator[Outcome]]:
        """As ``run``, but cells whose outcome is here are not run again, and those that are run are kept."""

        def evaluate(cells: Sequence[CandidateCell]) -> Iterator[Outcome]:
            missing = []
            for cell in cells:
                known = self.get(cell)
                if known is None:
                    missing.append(cell)
                else:
                    yield cell, known
            for cell, successes in run(missing) if missing else ():
                self.put(cell, successes)
                yield cell, successes

        return evaluate


def _key(cell: CandidateCell) -> str:
    return f"{cell.candidate.key} episodes {cell.start}-{cell.start + cell.n - 1}"
