"""Everything the diagnosis found, as one object: the command prints it, JSON holds it, plots draw it."""

from dataclasses import asdict, dataclass
from typing import Any, ClassVar

from lerobot_act_chunking.diagnostics.codebook.chunks import CodedChunks
from lerobot_act_chunking.diagnostics.codebook.drift import Drift
from lerobot_act_chunking.diagnostics.codebook.losses import Losses
from lerobot_act_chunking.diagnostics.codebook.meaning import CodeUse
from lerobot_act_chunking.diagnostics.codebook.settings import Thresholds
from lerobot_act_chunking.diagnostics.codebook.subject import Subject
from lerobot_act_chunking.diagnostics.codebook.usage import Usage
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.diagnostics.core.measures import Measure
from lerobot_act_chunking.diagnostics.core.report import Report


@dataclass(frozen=True, kw_only=True)
class CodebookReport(Report):
    """The answer to: what does this codebook do, and does it still fit?

    Attributes:
        subject: the tokenizer and where it comes from.
        demonstrations: the data that usage and errors are those of: what it was trained on, if that is here.
        coded: these, coded.
        uses: what each value of the first code does; empty where codes do not refine one another.
        drift: of other data, if any were given.
        other: these data, coded.
    """

    tool: ClassVar[str] = "codebook"
    subject: Subject
    demonstrations: ActionEpisodes
    measure: Measure
    coded: CodedChunks
    usage: Usage
    losses: Losses
    uses: list[CodeUse]
    drift: Drift | None
    other: CodedChunks | None
    thresholds: Thresholds
    notes: list[str]

    def content(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None for what was not or cannot be measured."""
        subject = self.subject
        return {
            "checkpoint": subject.source,
            "kind": subject.kind,
            "settings": dict(subject.settings),
            "dataset": self.demonstrations.folder,
            "episodes": list(self.demonstrations.episodes),
            "fps": self.demonstrations.fps,
            "n_chunks": len(self.coded.chunks),
            "chunk_size": subject.coder.timing.chunk_size,
            "chunk_stride": subject.coder.timing.chunk_stride,
            "verdict": self.verdict,
            "reasons": self.reasons,
            "thresholds": self.thresholds.to_json(),
            "usage": _usage_json(self.usage),
            "losses": asdict(self.losses),
            "first_code": [_use_json(use) for use in self.uses],
            "drift": self.drift and asdict(self.drift),
            "notes": self.notes,
        }


def _usage_json(usage: Usage) -> dict[str, Any]:
    return {
        "vocabulary": usage.vocabulary,
        "bits": usage.bits,
        "entropy_bits": usage.entropy_bits,
        "combinations": usage.combinations,
        "share_of_combinations": usage.share_of_combinations,
        "levels": [
            {"used": level.used, "perplexity": level.perplexity, "dead": level.dead, "counts": level.counts}
            for level in usage.levels
        ],
    }


def _use_json(use: CodeUse) -> dict[str, Any]:
    return {**asdict(use), "decoded": use.decoded.tolist()}
