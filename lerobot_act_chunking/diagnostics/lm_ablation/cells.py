"""What is compared: architectures, each with several starts."""

from dataclasses import dataclass
from typing import Any, Literal

Objective = Literal["distilled", "masked"]
Kind = Literal["text", "shuffled", "markov"]


@dataclass(frozen=True)
class Student:
    """An encoder that is pretrained here.

    Attributes:
        architecture: ``bert`` or ``mixer``.
        objective: learn the language model's states (``distilled``, with its table of word pieces), or words
            that are left out (``masked``, from random weights).
        kind: of the text: as it is, its word pieces in random order, or a chain that keeps which word piece
            follows which.
    """

    architecture: str
    objective: Objective
    kind: Kind

    @property
    def name(self) -> str:
        """Of its folder."""
        return f"{self.architecture}_{self.objective}_{self.kind}"


@dataclass(frozen=True)
class Cell:
    """An architecture with a start.

    Attributes:
        name: of it.
        architecture: ``bert`` or ``mixer``.
        init: ``encoder_init`` of the policy.
        training: ``encoder_training`` of the policy.
        student: the weights to start from; None for those of the language model.
    """

    name: str
    architecture: str
    init: str
    training: str = "full"
    student: Student | None = None

    @property
    def fields(self) -> dict[str, Any]:
        """Of the policy's configuration, but for the folder of the weights."""
        return {
            "encoder_impl": self.architecture,
            "encoder_init": self.init,
            "encoder_training": self.training,
        }


BERT, MIXER = "bert", "mixer"
_DISTILLED = {each: Student(each, "distilled", "text") for each in (BERT, MIXER)}
ALL = (
    Cell("T-R", BERT, "random"),
    Cell("T-LM'", BERT, "language_model", student=_DISTILLED[BERT]),
    Cell("M-R", MIXER, "random"),
    Cell("M-LM'", MIXER, "language_model", student=_DISTILLED[MIXER]),
    Cell("T-LM", BERT, "language_model"),
    Cell("T-permuted", BERT, "permuted"),
    *(
        Cell(f"T-{each}", BERT, f"only_{each}")
        for each in ("attention", "mlp", "norms", "positions", "embeddings")
    ),
    *(
        Cell(f"T-{kind}", BERT, "language_model", student=Student(BERT, "masked", kind))
        for kind in ("text", "shuffled", "markov")
    ),
    Cell("T-LM-frozen", BERT, "language_model", "frozen"),
    Cell("T-R-frozen", BERT, "random", "frozen"),
    Cell("T-LM-lora", BERT, "language_model", "lora"),
)
CELLS = {each.name: each for each in ALL}
"""The two by two first: transformer or mixer, random or pretrained on the same text by the same objective."""
FACTORIAL = ("T-R", "T-LM'", "M-R", "M-LM'")
REFERENCE = "T-R"
"""What every other cell is compared with."""
