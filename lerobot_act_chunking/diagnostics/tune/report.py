"""All that was measured and decided, as one object: the command prints it, JSON holds it, plots draw it."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

from lerobot_act_chunking.diagnostics.core.report import Report
from lerobot_act_chunking.diagnostics.tune.candidates import Candidate
from lerobot_act_chunking.diagnostics.tune.racing import Race
from lerobot_act_chunking.diagnostics.tune.replay import Replay
from lerobot_act_chunking.diagnostics.tune.settings import Settings
from lerobot_act_chunking.diagnostics.tune.verdict import TuneJudgement
from lerobot_act_chunking.diagnostics.tune.writing import Change


@dataclass(frozen=True, kw_only=True)
class TuneReport(Report):
    """The answer to: which execution suits this policy?

    Attributes:
        requested: what was asked.
        policy_type: of the checkpoint.
        where: the environment or the dataset.
        fps: control steps per second there.
        candidates: all, the present settings first.
        race: what episodes said, if any were run.
        replays: what recordings said, by candidate, if there was no environment.
        seen_in_training: whether the policy was trained on these recordings; None without any.
        changes: of the configuration, for the choice.
        written: whether they are in it now.
        wrap: the command for a checkpoint whose configuration cannot hold the choice.
        folder: where finished episodes are kept, if any were run.
        minutes: that it took.
    """

    tool: ClassVar[str] = "tune"
    requested: Settings
    policy_type: str
    where: str
    fps: float
    candidates: list[Candidate]
    race: Race[Candidate] | None = None
    replays: Mapping[Candidate, Replay] | None = None
    seen_in_training: bool | None = None
    judgement: TuneJudgement
    changes: list[Change]
    written: bool = False
    wrap: str | None = None
    folder: Path | None = None
    minutes: float

    @property
    def flags(self) -> str:
        """The options that make the choice for one run; none if nothing changes, or if it takes a wrapper."""
        return "" if self.wrap else " ".join(change.flag for change in self.changes)

    def content(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None for what was not or cannot be measured."""
        return {
            "checkpoint": self.requested.checkpoint,
            "policy_type": self.policy_type,
            "where": self.where,
            "success_key": self.requested.environment and self.requested.environment.success_key,
            "measured_by": "success" if self.race else "replay",
            "first_seed": self.requested.seed if self.race else None,
            "seen_in_training": self.seen_in_training,
            "minutes": self.minutes,
            "verdict": self.verdict,
            "reasons": self.reasons,
            "present": self.candidates[0].key,
            "chosen": self.judgement.chosen.key,
            "flags": self.flags,
            "wrap": self.wrap,
            "changes": [asdict(change) for change in self.changes],
            "written": self.written,
            "complete": self.race.complete if self.race else len(self.replays or {}) == len(self.candidates),
            "n_episodes": self.race.n_episodes if self.race else None,
            "candidates": [self._of(each) for each in self.candidates],
        }

    def _of(self, candidate: Candidate) -> dict[str, Any]:
        common = {
            "name": str(candidate),
            **dict(candidate.values),
            "calls_per_second": candidate.calls_per_second(self.fps),
        }
        if self.race is None:
            found = (self.replays or {}).get(candidate)
            return {**common, "replay": found and asdict(found)}
        if not self.race.results[candidate]:
            return {**common, "success": None}
        rate = self.race.rate(candidate)
        success = {**asdict(rate), "interval": list(rate.interval)}
        return {**common, "success": success, "dropped_after_round": self.race.dropped.get(candidate)}
