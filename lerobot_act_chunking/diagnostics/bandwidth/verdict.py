"""The answer in words: does the execution give the task what it needs?"""

from lerobot_act_chunking.diagnostics.bandwidth.agreement import Agreement
from lerobot_act_chunking.diagnostics.bandwidth.closed_form import ClosedForm
from lerobot_act_chunking.diagnostics.bandwidth.nonlinear import MeasuredStep
from lerobot_act_chunking.diagnostics.bandwidth.report import AtDisturbance
from lerobot_act_chunking.diagnostics.bandwidth.settings import BANDWIDTH_MARGIN, LATE, Limits
from lerobot_act_chunking.diagnostics.core.report import Judgement


def judge(
    figures: ClosedForm, agreement: Agreement, disturbed: AtDisturbance | None, limits: Limits, fps: float
) -> Judgement:
    """Hold the closed form against the executor and the limits.

    Args:
        figures: of the execution.
        agreement: of the executor with them.
        disturbed: what is left of the disturbance of ``limits``, if there is one.
        limits: what the task asks for.
        fps: control steps per second.
    """
    reasons = _broken_limits(figures, limits, fps)
    if not agreement.agrees:
        reasons.insert(
            0,
            f"the executor does not do what the formula says: step error {agreement.step_error:.1e}, plan "
            f"error {agreement.plan_error:.1e}, noise error {agreement.noise_error:.1e}; please report it",
        )
    if reasons:
        return Judgement("fail", reasons)
    if disturbed is not None and disturbed.missed > LATE:
        late = (
            f"at {disturbed.frequency_hz:g} Hz the command follows so late that {disturbed.missed:.0%} of "
            "the disturbance is left uncorrected"
        )
        return Judgement("warn", [late])
    return Judgement("pass", [_nothing_wrong(limits)])


def judge_steps(steps: list[MeasuredStep], replan_interval: int, limits: Limits, fps: float) -> Judgement:
    """Hold measured steps against the limits, for modes without a closed form."""
    settle = (max(step.settle_90_steps for step in steps) + replan_interval - 1) / fps
    if limits.max_settle_s is not None and settle > limits.max_settle_s:
        return Judgement(
            "fail",
            [f"90 % of a step takes up to {settle:.2f} s, measured; allowed: {limits.max_settle_s:g} s"],
        )
    if limits.disturbance_hz is not None or limits.loop_gain is not None:
        return Judgement(
            "inconclusive", ["this mode has no transfer function to hold against a frequency or a gain"]
        )
    return Judgement("pass", [_nothing_wrong(limits)])


def _broken_limits(figures: ClosedForm, limits: Limits, fps: float) -> list[str]:
    """What is wrong with these figures, one sentence each; empty if every limit is met."""
    reasons, thresholds = [], limits.thresholds()
    least = thresholds.get("min_bandwidth_hz")
    if least is not None and figures.bandwidth_hz is not None and figures.bandwidth_hz < least:
        reasons.append(
            f"disturbances of {limits.disturbance_hz:g} Hz need a bandwidth of {least:g} Hz "
            f"({BANDWIDTH_MARGIN:g} times as much), but it is {figures.bandwidth_hz:.3g} Hz"
        )
    settle = figures.phases["worst"].settle_90_steps / fps
    if limits.max_settle_s is not None and settle > limits.max_settle_s:
        reasons.append(
            f"90 % of a correction takes up to {settle:.2f} s; allowed are {limits.max_settle_s:g} s"
        )
    if limits.loop_gain is not None and figures.k_max < thresholds["min_k_max"]:
        reasons.append(
            f"a loop gain of {limits.loop_gain:g} per step is more than half the limit {figures.k_max:.3g}, "
            f"beyond which the loop oscillates ever more"
        )
    return reasons


def _nothing_wrong(limits: Limits) -> str:
    if limits.given:
        return "every limit is met"
    return "no limit was given (--disturbance-hz, --max-settle-s, --loop-gain): only the formula was checked"
