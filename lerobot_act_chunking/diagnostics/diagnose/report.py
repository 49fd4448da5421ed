"""All that was found, as one object: the command prints it, JSON holds it, plots draw it."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from lerobot_act_chunking.diagnostics.core.report import Report
from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.diagnostics.diagnose.effects import Effect
from lerobot_act_chunking.diagnostics.diagnose.looking import Seen
from lerobot_act_chunking.diagnostics.diagnose.measuring import Measured
from lerobot_act_chunking.diagnostics.diagnose.settings import Settings
from lerobot_act_chunking.diagnostics.diagnose.verdict import Cause, DiagnoseJudgement


@dataclass(frozen=True, kw_only=True)
class DiagnoseReport(Report):
    """The answer to: why does this policy fail?

    Attributes:
        requested: what was asked.
        policy_type: of the checkpoint.
        where: the environment or the dataset.
        dt: control period [s]; None without an environment.
        seen: what could be seen.
        measured: what was done in the environment; None without one.
        repeats: whether the environment repeats itself; None where that was not tried.
        folder: where finished episodes are kept; None without an environment.
        minutes: that it took.
        notes: what to know beside.
    """

    tool: ClassVar[str] = "diagnose"
    requested: Settings
    policy_type: str
    where: str
    dt: float | None
    seen: Seen
    measured: Measured | None
    judgement: DiagnoseJudgement
    repeats: bool | None = None
    folder: Path | None = None
    minutes: float
    notes: list[str]

    @property
    def causes(self) -> list[Cause]:
        """Those that are named, the one that explains most first."""
        return self.judgement.causes

    @property
    def effects(self) -> list[tuple[Effect, float]]:
        """What each intervention did, with its corrected p-value, the most effective first."""
        ranking = self.measured.ranking if self.measured else None
        return [] if ranking is None else list(zip(ranking.effects, ranking.p_values, strict=True))

    @property
    def failures(self) -> SuccessRate | None:
        """Failing episodes of the policy as it is; None where none was run."""
        if self.measured is None or not self.measured.records:
            return None
        return SuccessRate(len(self.measured.failures), len(self.measured.records))

    @property
    def good_until_s(self) -> float | None:
        """Median time until which a failing episode could still be saved [s]; None where it is not known."""
        moments = self.measured.moments if self.measured else None
        if moments is None or not moments.good or self.dt is None:
            return None
        return float(np.median(list(moments.good.values()))) * self.dt

    def content(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None for what was not or cannot be measured."""
        failures = self.failures
        return {
            "checkpoint": self.requested.checkpoint,
            "policy_type": self.policy_type,
            "where": self.where,
            "success_key": self.requested.environment and self.requested.environment.success_key,
            "first_seed": self.requested.seed,
            "minutes": self.minutes,
            "verdict": self.verdict,
            "reasons": self.reasons,
            "causes": [
                {"name": each.name, "evidence": each.evidence, "repair": each.repair} for each in self.causes
            ],
            "failures": None if failures is None else failures.successes,
            "episodes": None if failures is None else failures.episodes,
            "labels": self._labels(),
            "findings": [asdict(each) for each in self.seen.findings],
            "knowledge": {
                "own": self.seen.own and asdict(self.seen.own),
                "other": self.seen.other and asdict(self.seen.other),
            },
            "interventions": [_intervention(effect, p) for effect, p in self.effects],
            "repetition": self._repetition(),
            "repeats_itself": self.repeats,
            "moments": self._moments(),
            "complete": None if self.measured is None else self.measured.complete,
            "notes": self.notes,
        }

    def _labels(self) -> dict[str, int]:
        labels: dict[str, int] = {}
        for record in self.measured.failures if self.measured else ():
            label = record.episode.label or ""
            labels[label] = labels.get(label, 0) + 1
        return dict(sorted(labels.items(), key=lambda each: -each[1]))

    def _repetition(self) -> dict[str, Any] | None:
        rate = self.measured.repetition if self.measured else None
        return None if rate is None else _rate(rate)

    def _moments(self) -> dict[str, Any] | None:
        moments = self.measured.moments if self.measured else None
        if moments is None:
            return None
        return {
            "good_until_s": self.good_until_s,
            "good": {str(seed): step for seed, step in moments.good.items()},
            "lost": {str(seed): step for seed, step in moments.lost.items()},
            "saved_from_there": {
                trial.key: {"of": len(found), "saved": sum(found.values())}
                for trial, found in moments.found.items()
            },
        }


def _rate(rate: SuccessRate) -> dict[str, Any]:
    return {**asdict(rate), "interval": list(rate.exact_interval)}


def _intervention(effect: Effect, p: float) -> dict[str, Any]:
    trial = effect.trial
    return {
        "hypothesis": trial.hypothesis,
        "change": trial.change,
        "repair": trial.repair,
        "recovered": _rate(effect.recovered),
        "by_chance": effect.by_chance,
        "broken": None if effect.broken is None else _rate(effect.broken),
        "net": effect.net,
        "p_value": effect.p_value,
        "p_corrected": p,
    }
