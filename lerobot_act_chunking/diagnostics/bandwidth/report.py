"""Everything the diagnosis found, as one object: the command prints it, JSON holds it, plots draw it."""

from dataclasses import asdict, dataclass, fields
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lerobot_act_chunking.diagnostics.bandwidth.advice import LATE, Advice, Limits, judge, recommend
from lerobot_act_chunking.diagnostics.bandwidth.closed_form import (
    ClosedForm,
    SweepPoint,
    closed_form,
    filter_for,
    sweep,
)
from lerobot_act_chunking.diagnostics.bandwidth.measured import (
    NOISE_TOLERANCE,
    STEP_TOLERANCE,
    Agreement,
    check_agreement,
)
from lerobot_act_chunking.diagnostics.bandwidth.nonlinear import MeasuredStep, measure_steps
from lerobot_act_chunking.diagnostics.bandwidth.source import Source
from lerobot_act_chunking.diagnostics.core.checks import check_positive
from lerobot_act_chunking.diagnostics.core.outcome import EXIT_CODES, write_json
from lerobot_act_chunking.diagnostics.core.training import untrained

if TYPE_CHECKING:
    from lerobot_act_chunking.diagnostics.bandwidth.push import PushStudy

PLAN_PASSES = (
    "Only innovations are filtered: what all chunks agree on, the plan, passes with gain 1 and no delay."
)
SAME_GAIN = (
    "act and recency with the same coefficient have the same gain |H| and bandwidth (one is the other "
    "reversed in time); they differ in delay: the group delays add up to {sum} steps."
)
SETTLE_IS_WINDOW = (
    "All of a correction takes as long as chunks are used, whatever the weights: the first-order low-pass of "
    "the textbook is only the limit of recency weights that fade well within a chunk."
)
SAMPLED_PLAN = (
    "Without averaging the newest chunk decides alone: dead time until the next inference, then all at once."
)
NO_FORMULA = (
    "The weights depend on what the chunks say, so there is no transfer function: the step responses "
    "are measured on the executor, for steps of several sizes."
)
UNKNOWN_RATE = (
    "The checkpoint does not tell its control rate: figures in Hz and s are for {fps:g} steps a second; give "
    "--fps if it is another."
)
OTHER_RATE = (
    "The policy was trained at {trained:g} control steps a second; figures in Hz and s are for {fps:g}."
)
GRIPPERS = "Dimensions {dims} (grippers) follow the newest chunk alone and are not part of these figures."


@dataclass(frozen=True)
class AtDisturbance:
    """What the filter does to a disturbance of one frequency.

    ``missed`` is ``|1 - H|``, the amplitude of what is left uncorrected, relative to the disturbance.
    """

    frequency_hz: float
    gain: float
    phase_deg: float
    missed: float


@dataclass(frozen=True)
class BandwidthReport:
    """The answer to: how fast can this policy react?

    ``figures`` and ``agreement`` are None, and ``measured_steps`` is not empty, for the modes without a
    closed form.
    """

    source: Source
    fps: float
    limits: Limits
    figures: ClosedForm | None
    agreement: Agreement | None
    measured_steps: list[MeasuredStep]
    sweep: list[SweepPoint]
    at_disturbance: AtDisturbance | None
    advice: Advice | None
    verdict: str
    reasons: list[str]
    notes: list[str]
    push: "PushStudy | None" = None

    @property
    def exit_code(self) -> int:
        """Of the command: 0 pass or warn, 1 fail, 2 inconclusive."""
        return EXIT_CODES[self.verdict]

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None where there is no finite number."""
        names = [field.name for field in fields(ClosedForm)]
        figures = dict.fromkeys(names) if self.figures is None else asdict(self.figures)
        return {
            "tool": "bandwidth",
            "version": version("lerobot_policy_act_chunking"),
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

    def write_json(self, path: Path) -> Path:
        """Write `to_json` to a file, creating its folder."""
        return write_json(self.to_json(), path)


def analyse(source: Source, fps: float, limits: Limits, push: "PushStudy | None" = None) -> BandwidthReport:
    """Closed form, check on the real executor, verdict and recommendation.

    Args:
        source: the execution.
        fps: control steps per second.
        limits: what the task asks for.
        push: the same question asked in simulation, if it was.

    Raises:
        ConfigurationError: ``fps`` is not positive.
    """
    check_positive(fps=fps)
    settings = source.settings
    kernel, figures = filter_for(settings), closed_form(settings, fps)
    agreement = None if kernel is None else check_agreement(settings, kernel)
    steps = measure_steps(settings) if kernel is None else []
    at_disturbance = None
    if kernel is not None and limits.disturbance_hz is not None:
        at_disturbance = _at_disturbance(
            kernel.response(limits.disturbance_hz / fps)[0], limits.disturbance_hz
        )
    told = None if source.checkpoint is None else untrained(source.checkpoint)
    verdict, reasons = (
        _verdict_on_steps(steps, settings.replan_interval, limits, fps)
        if figures is None or agreement is None
        else _verdict(figures, agreement, at_disturbance, limits, fps)
    )
    return BandwidthReport(
        source=source,
        fps=fps,
        limits=limits,
        figures=figures,
        agreement=agreement,
        measured_steps=steps,
        sweep=sweep(settings, fps),
        at_disturbance=at_disturbance,
        advice=recommend(settings, limits, fps) if limits.given else None,
        verdict=verdict,
        reasons=reasons if told is None else [*reasons, f"execution alone was looked at: {told}"],
        notes=_notes(source, fps),
        push=push,
    )


def _at_disturbance(response: complex, frequency_hz: float) -> AtDisturbance:
    return AtDisturbance(
        frequency_hz=frequency_hz,
        gain=float(abs(response)),
        phase_deg=float(np.degrees(np.angle(response))),
        missed=float(abs(1 - response)),
    )


def _verdict(
    figures: ClosedForm, agreement: Agreement, disturbed: AtDisturbance | None, limits: Limits, fps: float
) -> tuple[str, list[str]]:
    reasons = judge(figures, limits, fps)
    if not agreement.agrees:
        reasons.insert(
            0,
            f"the executor does not do what the formula says: step error {agreement.step_error:.1e}, plan "
            f"error {agreement.plan_error:.1e}, noise error {agreement.noise_error:.1e}; please report it",
        )
    if reasons:
        return "fail", reasons
    if disturbed is not None and disturbed.missed > LATE:
        return "warn", [
            f"at {disturbed.frequency_hz:g} Hz the command follows so late that {disturbed.missed:.0%} of "
            "the disturbance is left uncorrected"
        ]
    return "pass", [_nothing_wrong(limits)]


def _verdict_on_steps(
    steps: list[MeasuredStep], replan_interval: int, limits: Limits, fps: float
) -> tuple[str, list[str]]:
    settle = (max(step.settle_90_steps for step in steps) + replan_interval - 1) / fps
    if limits.max_settle_s is not None and settle > limits.max_settle_s:
        return "fail", [
            f"90 % of a step takes up to {settle:.2f} s, measured; allowed: {limits.max_settle_s:g} s"
        ]
    if limits.disturbance_hz is not None or limits.loop_gain is not None:
        return "inconclusive", ["this mode has no transfer function to hold against a frequency or a gain"]
    return "pass", [_nothing_wrong(limits)]


def _nothing_wrong(limits: Limits) -> str:
    if limits.given:
        return "every limit is met"
    return "no limit was given (--disturbance-hz, --max-settle-s, --loop-gain): only the formula was checked"


def _notes(source: Source, fps: float) -> list[str]:
    settings = source.settings
    notes = [PLAN_PASSES]
    if settings.execution == "ensemble":
        delays = settings.n_action_steps - 1 + settings.latency_steps
        notes += [SAME_GAIN.format(sum=delays), SETTLE_IS_WINDOW]
    elif settings.execution in ("open_loop", "receding"):
        notes.append(SAMPLED_PLAN)
    elif settings.execution in ("adaptive", "coherence"):
        notes = [NO_FORMULA]
    if source.checkpoint is not None and source.fps is None:
        notes.insert(0, UNKNOWN_RATE.format(fps=fps))
    elif source.fps is not None and source.fps != fps:
        notes.insert(0, OTHER_RATE.format(trained=source.fps, fps=fps))
    if settings.gripper_dims:
        notes.append(GRIPPERS.format(dims=list(settings.gripper_dims)))
    return notes


def _agreement_json(agreement: Agreement | None) -> dict[str, Any] | None:
    if agreement is None:
        return None
    errors = {name: getattr(agreement, name) for name in ("step_error", "plan_error", "noise_error")}
    return {**errors, "agrees": agreement.agrees}
