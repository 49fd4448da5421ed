"""Which tokenizer suits a dataset, as one object: the command prints it, JSON holds it, plots draw it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.diagnostics.codebook.candidates import Candidate
from lerobot_act_chunking.diagnostics.codebook.losses import Losses
from lerobot_act_chunking.diagnostics.codebook.verdict import Judgement, Thresholds
from lerobot_act_chunking.diagnostics.core import outcome
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes


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


@dataclass(frozen=True)
class ComparisonReport:
    """The answer to: which tokenizer suits these demonstrations?

    Attributes:
        held_out: episodes that the errors are those of.
        steps: of fitting, where there is something to learn.
        recommended: the fewest bits that lose no more than the first threshold allows.
    """

    demonstrations: ActionEpisodes
    timing: ChunkTiming
    held_out: Sequence[int]
    steps: int
    fitted: list[Fitted]
    recommended: Fitted
    thresholds: Thresholds
    judgement: Judgement

    @property
    def exit_code(self) -> int:
        """Of the command: 0 pass or warn, 1 fail."""
        return outcome.EXIT_CODES[self.judgement.verdict]

    @property
    def flags(self) -> str:
        """The options of ``lerobot-train`` for what is recommended."""
        timing = (
            f"--policy.chunk_size={self.timing.chunk_size} --policy.chunk_stride={self.timing.chunk_stride}"
        )
        return f"{self.recommended.candidate.flags} {timing}"

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries."""
        return {
            "tool": "codebook",
            "version": version("lerobot_policy_act_chunking"),
            "dataset": self.demonstrations.folder,
            "held_out": list(self.held_out),
            "fps": self.demonstrations.fps,
            "chunk_size": self.timing.chunk_size,
            "chunk_stride": self.timing.chunk_stride,
            "steps": self.steps,
            "verdict": self.judgement.verdict,
            "reasons": self.judgement.reasons,
            "thresholds": {"lost_variance": self.thresholds.lost_variance},
            "recommended": {"name": self.recommended.candidate.name, "flags": self.flags},
            "tokenizers": [_fitted_json(each) for each in self.fitted],
        }

    def write_json(self, path: Path) -> Path:
        """Write `to_json` to a file, creating its folder."""
        return outcome.write_json(self.to_json(), path)


def _fitted_json(fitted: Fitted) -> dict[str, Any]:
    content = asdict(fitted)
    return {"name": fitted.candidate.name, **content.pop("candidate")["settings"], **content}
