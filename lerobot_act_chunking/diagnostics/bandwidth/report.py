"""Everything the diagnosis found, as one object: the command prints it, JSON holds it, plots draw it."""

from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar

from lerobot_act_chunking.diagnostics.bandwidth.advice import Advice
from lerobot_act_chunking.diagnostics.bandwidth.agreement import NOISE_TOLERANCE, STEP_TOLERANCE, Agreement
from lerobot_act_chunking.diagnostics.bandwidth.closed_form import ClosedForm, SweepPoint
from lerobot_act_chunking.diagnostics.bandwidth.nonlinear import MeasuredStep
from lerobot_act_chunking.diagnostics.bandwidth.settings import Limits
from lerobot_act_chunking.diagnostics.bandwidth.source import Source
from lerobot_act_chunking.diagnostics.core.report import Report

if TYPE_CHECKING:
    from lerobot_act_chunking.diagnostics.bandwidth.push import PushStudy


@dataclass(frozen=True)
class AtDisturbance:
    """What the filter does to a disturbance of one frequency.

    ``missed`` is ``|1 - H|``, the amplitude of what is left uncorrected, relative to the disturbance.
    """

    frequency_hz: float
    gain: float
    phase_deg: float
    missed: float


@dataclass(frozen=True, kw_only=True)
class BandwidthReport(Report):
    """The answer to: how fast can this policy react?

    ``figures`` and ``agreement`` are None, and ``measured_steps`` is not empty, for the modes without a
    closed form.
    """

    tool: ClassVar[str] = "bandwidth"
    source: Source
    fps: float
    limits: Limits
    figures: ClosedForm | None
    agreement: Agreement | None
    measured_steps: list[MeasuredStep]
    sweep: list[SweepPoint]
    at_disturbance: AtDisturbance | None
    advice: Advice | None
    notes: list[str]
    push: "PushStudy | None" = None

    def content(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None for what was not or cannot be measured."""
        names = [field.name for field in fields(ClosedForm)]
        figures = dict.fromkeys(names) if self.figures is None else asdict(self.figures)
        return {
            "checkpoint": self.source.checkpoint,
            "policy_type": self.source.policy_type,
            "settings": asdict(self.source.settings),
            "fps": self.fps,
            "verdict": self.verdict,
            "reasons": self.reasons,
            "thresholds": self.limits.thresholds()
            | {"max_step_error": STEP_TOLERANCE, "max_noise_error": NOISE_TOLERANCE},
            **figures,
            "measured": _agreement_json(self.agreement),
            "measured_steps": [asdict(step) for step in self.measured_steps],
            "at_disturbance": self.at_disturbance and asdict(self.at_disturbance),
            "sweep": [asdict(point) for point in self.sweep],
            "advice": self.advice and asdict(self.advice),
            "push": self.push and self.push.to_json(),
            "notes": self.notes,
        }


def _agreement_json(agreement: Agreement | None) -> dict[str, Any] | None:
    if agreement is None:
        return None
    errors = {name: getattr(agreement, name) for name in ("step_error", "plan_error", "noise_error")}
    return {**errors, "agrees": agreement.agrees}
