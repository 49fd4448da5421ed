"""Everything that was found, as one object: the command prints it, JSON holds it, plots draw it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

from lerobot_act_chunking.diagnostics.core.report import Report
from lerobot_act_chunking.diagnostics.lm_ablation.effects import Effect
from lerobot_act_chunking.diagnostics.lm_ablation.matching import Match
from lerobot_act_chunking.diagnostics.lm_ablation.records import Record
from lerobot_act_chunking.diagnostics.lm_ablation.settings import Settings


@dataclass(frozen=True)
class Row:
    """A cell at a number of demonstrations.

    Attributes:
        cell: its name.
        size: demonstrations.
        trainings: how many seeds.
        success: mean rate under each condition.
        validation_loss: mean of the least loss of each training.
        learned_after: median of the steps until the validation loss was low; None if most never got there.
        moved: how far training moved each kind of the encoder's weights, as a share of what they were.
        seconds: CPU time of a training with its episodes.
    """

    cell: str
    size: int
    trainings: int
    success: dict[str, float]
    validation_loss: float
    learned_after: float | None
    moved: dict[str, float]
    seconds: float


@dataclass(frozen=True, kw_only=True)
class LmAblationReport(Report):
    """The answer to: does a language model's start help a policy's encoder, and which part of it?

    Attributes:
        settings: what was asked.
        match: of both architectures.
        rows: of each cell and size.
        effects: on success, each with its interval.
        records: every training.
        notes: what to know about the figures.
    """

    tool: ClassVar[str] = "lm_ablation"
    settings: Settings
    match: Match
    rows: Sequence[Row]
    effects: Sequence[Effect]
    records: Sequence[Record]
    notes: Sequence[str]

    def content(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None for what was not or cannot be measured."""
        settings = self.settings
        return {
            "verdict": self.verdict,
            "reasons": self.reasons,
            "thresholds": asdict(settings.thresholds),
            "policy_type": "act_chunked",
            "settings": {
                "environment": {
                    "type": settings.environment.type,
                    "arguments": dict(settings.environment.arguments),
                },
                "conditions": list(settings.conditions),
                "policy": dict(settings.policy),
                "text_tokens": settings.text_tokens,
                "held_out": settings.held_out,
                "seed": settings.seed,
                **asdict(settings.budget),
            },
            "match": {
                **asdict(self.match),
                "parameters_apart": self.match.parameters_apart,
                "flops_apart": self.match.flops_apart,
            },
            "cells": [asdict(each) for each in self.rows],
            "effects": [asdict(each) for each in self.effects],
            "trainings": [
                {
                    **asdict(each),
                    "successes": {name: _digits(won) for name, won in each.successes.items()},
                }
                for each in self.records
            ],
            "notes": list(self.notes),
        }


def _digits(successes: Sequence[bool]) -> str:
    """1 for each episode that succeeded, 0 for each other: a line in place of hundreds."""
    return "".join("01"[won] for won in successes)
