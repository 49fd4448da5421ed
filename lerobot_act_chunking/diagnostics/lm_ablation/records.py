"""What came of each training, and where it is kept."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lerobot_act_chunking.durable_files import write_atomically
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.json_files import read_json

QUESTION, TRAININGS = "question.json", "trainings"


@dataclass(frozen=True)
class Record:
    """One training.

    Attributes:
        cell: its name.
        size: demonstrations.
        seed: of the training.
        curve: steps, and the validation loss after so many.
        successes: which episodes succeeded, under each condition.
        moved: how far training moved each kind of the body's weights, as a share of what they were.
        seconds: of CPU time.
    """

    cell: str
    size: int
    seed: int
    curve: tuple[tuple[int, float], ...]
    successes: Mapping[str, tuple[bool, ...]]
    moved: Mapping[str, float]
    seconds: float

    def learned_after(self, share: float) -> int | None:
        """Steps until the validation loss was this share of the one before training; None if it never was."""
        first = self.curve[0][1]
        return next((step for step, loss in self.curve if loss <= share * first), None)

    @property
    def best_loss(self) -> float:
        """The least validation loss."""
        return min(loss for _, loss in self.curve)


class Store:
    """The finished trainings of one question.

    Args:
        folder: of its files.
        question: what every training depends on, but for its cell, size and seed.

    Raises:
        ConfigurationError: the folder holds the trainings of another question.
    """

    def __init__(self, folder: Path, question: Mapping[str, Any]) -> None:
        self.folder = folder
        path = folder / QUESTION
        if path.exists():
            there = read_json(path)
            differing = sorted(name for name in {*there, *question} if there.get(name) != question.get(name))
            if differing:
                raise ConfigurationError(
                    f"{folder} holds trainings of another {' and '.join(differing)}: choose another "
                    "--output-dir"
                )
        write_atomically(path, _json(question))

    def path(self, cell: str, size: int, seed: int) -> Path:
        """Of a training's file."""
        return self.folder / TRAININGS / f"{cell}_{size}_{seed}.json"

    def keep(self, record: Record) -> None:
        """Write a finished training down."""
        write_atomically(self.path(record.cell, record.size, record.seed), _json(asdict(record)))

    def records(self) -> Iterator[Record]:
        """All that are finished.

        Raises:
            ConfigurationError: a file is damaged.
        """
        for path in sorted((self.folder / TRAININGS).glob("*.json")):
            try:
                found = read_json(path)
                curve = tuple((int(step), float(loss)) for step, loss in found.pop("curve"))
                yield Record(curve=curve, **found)
            except (ValueError, TypeError, KeyError) as error:
                raise ConfigurationError(
                    f"{path} cannot be read ({error!r}): remove it, and it is trained again"
                ) from error


def _json(content: Any) -> bytes:
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()
