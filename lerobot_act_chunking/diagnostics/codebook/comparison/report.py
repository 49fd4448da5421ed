"""Everything the comparison found, as one object: the command prints it, JSON holds it, plots draw it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.diagnostics.codebook.comparison.candidates import Candidate
from lerobot_act_chunking.diagnostics.codebook.losses import Losses
from lerobot_act_chunking.diagnostics.codebook.settings import Thresholds
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.diagnostics.core.report import Report


@dataclass(frozen=True)
class Fitted:
    """One tokenizer, fitted to most episodes and tried on the others.

    Attributes:
        tokens: per chunk.
        vocabulary: values that each may have.
        bits: per chunk.
        entropy_bits: per chunk, if frequent values cost less.
        losses: on the episodes held out.
        seconds: of CPU that fitting took.
    """

    candidate: Candidate
    tokens: int
    vocabulary: int
    bits: float
    entropy_bits: float
    losses: Losses
    seconds: float


@dataclass(frozen=True, kw_only=True)
class ComparisonReport(Report):
    """The answer to: which tokenizer suits these demonstrations?

    Attributes:
        held_out: episodes that the errors are those of.
        steps: of fitting, where there is something to learn.
        recommended: the fewest bits that lose no more than the first threshold allows.
    """

    tool: ClassVar[str] = "codebook"
    demonstrations: ActionEpisodes
    timing: ChunkTiming
    held_out: Sequence[int]
    steps: int
    fitted: list[Fitted]
    recommended: Fitted
    thresholds: Thresholds

    @property
    def flags(self) -> str:
        """The options of ``lerobot-train`` for what is recommended."""
        timing = (
            f"--policy.chunk_size={self.timing.chunk_size} --policy.chunk_stride={self.timing.chunk_stride}"
        )
        return f"{self.recommended.candidate.flags} {timing}"

    def content(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None for what was not or cannot be measured."""
        return {
            "dataset": self.demonstrations.folder,
            "held_out": list(self.held_out),
            "fps": self.demonstrations.fps,
            "chunk_size": self.timing.chunk_size,
            "chunk_stride": self.timing.chunk_stride,
            "steps": self.steps,
            "verdict": self.verdict,
            "reasons": self.reasons,
            "thresholds": {"lost_variance": self.thresholds.lost_variance},
            "recommended": {"name": self.recommended.candidate.name, "flags": self.flags},
            "tokenizers": [_fitted_json(each) for each in self.fitted],
        }


def _fitted_json(fitted: Fitted) -> dict[str, Any]:
    content = asdict(fitted)
    return {"name": fitted.candidate.name, **content.pop("candidate")["settings"], **content}
