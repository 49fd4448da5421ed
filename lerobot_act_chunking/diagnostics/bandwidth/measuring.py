"""From an execution to a `BandwidthReport`."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from act_chunking_runtime.number_checks import check_positive
from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.bandwidth.advice import recommend
from lerobot_act_chunking.diagnostics.bandwidth.agreement import check_agreement
from lerobot_act_chunking.diagnostics.bandwidth.closed_form import closed_form, filter_for, in_hertz, sweep
from lerobot_act_chunking.diagnostics.bandwidth.filter import InnovationFilter
from lerobot_act_chunking.diagnostics.bandwidth.nonlinear import measure_steps
from lerobot_act_chunking.diagnostics.bandwidth.report import AtDisturbance, BandwidthReport
from lerobot_act_chunking.diagnostics.bandwidth.settings import Limits
from lerobot_act_chunking.diagnostics.bandwidth.source import Source
from lerobot_act_chunking.diagnostics.bandwidth.verdict import judge, judge_steps
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
SMOOTHED = (
    "Within each chunk the mean over {steps} steps damps the plan itself, without delay: half of its power "
    "is gone at {hz:.2g} Hz. Corrections arrive as fast as without it."
)
GRIPPERS = "Dimensions {dims} (grippers) follow the newest chunk alone and are not part of these figures."


def measure(source: Source, fps: float, limits: Limits, push: "PushStudy | None" = None) -> BandwidthReport:
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
    message = None if source.checkpoint is None else untrained(source.checkpoint)
    judgement = (
        judge_steps(steps, settings.replan_interval, limits, fps)
        if figures is None or agreement is None
        else judge(figures, agreement, at_disturbance, limits, fps)
    )
    if message is not None:
        reasons = [*judgement.reasons, f"execution alone was looked at: {message}"]
        judgement = replace(judgement, reasons=reasons)
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
        judgement=judgement,
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
    if settings.smoothing_steps > 1:
        notes.append(SMOOTHED.format(steps=settings.smoothing_steps, hz=_half_power_hz(settings, fps)))
    if settings.gripper_dims:
        notes.append(GRIPPERS.format(dims=list(settings.gripper_dims)))
    return notes


def _half_power_hz(settings: ExecutionSettings, fps: float) -> float | None:
    """Frequency at which the moving mean within a chunk halves the power of the plan."""
    steps = settings.smoothing_steps
    mean = InnovationFilter(np.full(steps, 1 / steps), replan_interval=1, latency=0)
    return in_hertz(mean.bandwidth, fps)
