"""Everything the diagnosis found, as one object: the command prints it, JSON holds it, plots draw it."""

from dataclasses import asdict, dataclass
from typing import Any, ClassVar

from lerobot_act_chunking.diagnostics.core.report import Report
from lerobot_act_chunking.diagnostics.steps import plateau
from lerobot_act_chunking.diagnostics.steps.grid import Cell
from lerobot_act_chunking.diagnostics.steps.results import CellResult, Sweep
from lerobot_act_chunking.diagnostics.steps.settings import Settings
from lerobot_act_chunking.diagnostics.steps.sources import HeldOut
from lerobot_act_chunking.diagnostics.steps.success import SuccessOfCell
from lerobot_act_chunking.diagnostics.steps.verdict import StepsJudgement


@dataclass(frozen=True, kw_only=True)
class StepsReport(Report):
    """The answer to: are these denoising steps enough, and would more help?

    Attributes:
        requested: the settings of the diagnosis.
        settings: how the policy samples and executes.
        own: the cell that is judged.
    """

    tool: ClassVar[str] = "steps"
    requested: Settings
    settings: dict[str, Any]
    own: Cell
    held_out: HeldOut
    tolerance: float
    sweep: Sweep
    judgement: StepsJudgement
    notes: list[str]
    success: list[SuccessOfCell] | None = None

    @property
    def unit(self) -> str:
        """Of all distances."""
        return self.held_out.measure.unit

    def content(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None for what was not or cannot be measured."""
        judgement = self.judgement
        recommended = judgement.recommended
        return {
            "checkpoint": self.requested.checkpoint,
            "policy_type": self.settings["type"],
            "settings": self.settings,
            "dataset": self.held_out.dataset,
            "episodes": self.held_out.episodes,
            "seen_in_training": self.held_out.seen_in_training,
            "n_observations": self.sweep.n_observations,
            "n_near_contact": self.sweep.n_near_contact,
            "fps": self.held_out.fps,
            "seed": self.requested.seed,
            "verdict": self.verdict,
            "reasons": self.reasons,
            "thresholds": self._thresholds(),
            "unit": self.unit,
            "own": asdict(self.own),
            "limit": judgement.limit,
            "recommended": recommended and {**asdict(recommended), "flags": recommended.flags},
            "reference": asdict(self.sweep.reference),
            "series": [asdict(series) for series in judgement.series],
            "cells": [_flat(result) for result in self.sweep.cells],
            "success": self.success and [each.to_json() for each in self.success],
            "notes": self.notes,
        }

    def _thresholds(self) -> dict[str, float]:
        return {
            "tolerance": self.tolerance,
            "same_demonstration_error": plateau.SAME_DEMONSTRATION_ERROR,
            "no_improvement": plateau.NO_IMPROVEMENT,
            "model_limited_from": plateau.BY_FAR * self.tolerance,
            "below_spread": plateau.BELOW_SPREAD,
            "not_converged": plateau.NOT_CONVERGED,
        }


def _flat(result: CellResult) -> dict[str, Any]:
    content = asdict(result)
    return {**content.pop("cell"), **content}
