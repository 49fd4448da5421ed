"""Finished episodes on the disk, so that a race can be stopped and gone on with."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from lerobot_act_chunking.diagnostics.core.outcomes import Outcomes
from lerobot_act_chunking.diagnostics.tune.measuring import CandidateCell, Outcome

DEFAULT_PARENT = Path("outputs/tune")


class Store(Outcomes):
    """The outcomes of cells.

    Args:
        question: as of `Outcomes`.
        folder: of the file; by default one that follows from the question.

    Raises:
        ConfigurationError: as `Outcomes`.
    """

    def __init__(self, question: dict[str, Any], folder: Path | None) -> None:
        super().__init__(question, folder, DEFAULT_PARENT)

    def remembering(
        self, run: Callable[[Sequence[CandidateCell]], Iterator[Outcome]]
    ) -> Callable[[Sequence[CandidateCell]], Iterator[Outcome]]:
        """As ``run``, but cells whose outcome is here are not run again, and those that are run are kept."""

        def evaluate(cells: Sequence[CandidateCell]) -> Iterator[Outcome]:
            missing = []
            for cell in cells:
                known = self.get(_key(cell))
                if known is None:
                    missing.append(cell)
                else:
                    yield cell, known
            for cell, successes in run(missing) if missing else ():
                self.put(_key(cell), successes)
                yield cell, successes

        return evaluate


def _key(cell: CandidateCell) -> str:
    return f"{cell.candidate.key} episodes {cell.start}-{cell.start + cell.n - 1}"
