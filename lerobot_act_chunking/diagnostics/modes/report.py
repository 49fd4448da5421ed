"""Everything that was found: the command prints it, JSON holds it, plots draw it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float, Int64

from lerobot_act_chunking.diagnostics.core.report import Report
from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.diagnostics.modes.demonstrated import Reference
from lerobot_act_chunking.diagnostics.modes.frequencies import Frequencies
from lerobot_act_chunking.diagnostics.modes.inside import Inside
from lerobot_act_chunking.diagnostics.modes.settings import Settings
from lerobot_act_chunking.diagnostics.modes.switching import Switching
from lerobot_act_chunking.diagnostics.modes.verdict import ModeJudgement


@dataclass(frozen=True)
class SampledChunks:
    """Chunks at the starts of episodes.

    Attributes:
        frequencies: the ways that they go.
        per_start: samples of each start; 1 of a policy that always predicts the same.
        deterministic: whether it does.
        chunks: (n, T, A) in units of each dimension's spread.
        modes: (n,) the way of each, -1 for none.
        reference: the demonstrated chunks that they were held against.
    """

    frequencies: Frequencies
    per_start: int
    deterministic: bool
    chunks: Float[np.ndarray, "n T A"]
    modes: Int64[np.ndarray, " n"]
    reference: Reference


@dataclass(frozen=True, kw_only=True)
class ModesReport(Report):
    """The answer to: does it take the demonstrated ways, as often?

    Attributes:
        requested: what was asked.
        policy_type: as ``--policy.type``.
        dataset: the demonstrations' folder, if they are here.
        source: where the proportions are from: ``recording``, ``clusters`` or ``shares``.
        told_by: what says which way an episode went: the ``environment``, or the commanded ``motion``.
        episodes: the ways that they went; None if no ways are known.
        successes: of each way, and last of none of them; None of those that no episode went, and of all where
            the environment says nothing of success.
        chunks: sampled at the starts; None if they could not be looked at.
        switching: of the way within episodes.
        inside: of a policy with a latent or with codes.
        notes: what to know about the figures.
    """

    tool: ClassVar[str] = "modes"
    requested: Settings
    policy_type: str
    judgement: ModeJudgement
    dataset: str | None = None
    source: str | None = None
    told_by: str | None = None
    episodes: Frequencies | None = None
    successes: Sequence[SuccessRate | None] = ()
    chunks: SampledChunks | None = None
    switching: Switching | None = None
    inside: Inside | None = None
    notes: list[str] = field(default_factory=list)

    def content(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None for what was not or cannot be measured."""
        asked, cause = self.requested, self.judgement.cause
        thresholds = asked.thresholds
        chunks = self.chunks and {
            **self.chunks.frequencies.to_json(thresholds),
            "per_start": self.chunks.per_start,
            "deterministic": self.chunks.deterministic,
            "limit": self.chunks.reference.limit,
        }
        return {
            "verdict": self.verdict,
            "reasons": self.reasons,
            "cause": cause.name,
            "because": cause.because,
            "fix": cause.fix,
            "thresholds": asdict(thresholds),
            "checkpoint": asked.checkpoint,
            "policy_type": self.policy_type,
            "environment": asked.environment.name,
            "success_key": asked.environment.success_key,
            "dataset": self.dataset,
            "seed": asked.seed,
            "source": self.source,
            "told_by": self.told_by,
            "proportions": self.episodes and list(self.episodes.proportions),
            "episodes": self.episodes and self.episodes.to_json(thresholds),
            "successes": [each and [each.successes, each.episodes] for each in self.successes],
            "chunks": chunks,
            "switching": self.switching and {**vars(self.switching), "share": self.switching.share},
            "inside": self.inside and self.inside.to_json(thresholds),
            "notes": self.notes,
        }
