"""The answer in words: is the stride fine enough for these demonstrations?"""

import numpy as np

from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.diagnostics.core.noise_floor import NoiseFloor
from lerobot_act_chunking.diagnostics.core.report import Judgement
from lerobot_act_chunking.diagnostics.resolution.settings import Criteria
from lerobot_act_chunking.diagnostics.resolution.strides import Stride, Tolerance, counting

MOST_ABOVE_NYQUIST = 0.01
FEWEST_STEPS = 256


def judge(
    demonstrations: ActionEpisodes,
    criteria: Criteria,
    judged: Stride,
    recommended: Stride,
    tolerance: Tolerance,
    floor: NoiseFloor,
) -> Judgement:
    """Hold one stride against the tolerance, and its dimensions against what they should show.

    Args:
        demonstrations: the data.
        criteria: what strides are held against.
        judged: the stride in question.
        recommended: the one to take instead, if that is too coarse.
        tolerance: what actions may be off.
        floor: which dimensions move.
    """
    n_steps = sum(map(len, demonstrations.episodes.values()))
    if n_steps < FEWEST_STEPS:
        return Judgement(
            "inconclusive", [f"{n_steps} control steps are too few to judge by, it takes {FEWEST_STEPS}"]
        )
    if np.isnan(judged.above_nyquist):
        return Judgement("inconclusive", [_nothing_moves(floor)])
    if not judged.worst <= tolerance.value:
        return Judgement("fail", [_too_coarse(judged, recommended, tolerance)])
    within = f"at chunk_stride={judged.stride} {_deviation(judged, tolerance)} (95 % of the steps)"
    reasons = [f"{within}, allowed {tolerance}"]
    counted = counting(floor, criteria.gripper_dims)
    fast = [
        f"{demonstrations.names[dim]} ({share:.1%})"
        for dim in counted
        if (share := judged.dimensions_above_nyquist[dim]) > MOST_ABOVE_NYQUIST
    ]
    if fast:
        reasons.append(
            f"but energy lies above {judged.nyquist_hz:.3g} Hz, which predictions so far apart cannot show, "
            f"and returns as slower motion that nobody demonstrated: {', '.join(fast)}"
        )
    hold = [] if tolerance.unit == "mm" else _to_hold(judged, floor, criteria, tolerance)
    if hold:
        named = ", ".join(f"{demonstrations.names[dim]} ({judged.shares[dim]:.1%})" for dim in hold)
        dims = ",".join(map(str, sorted({*hold, *criteria.gripper_dims})))
        reasons.append(
            f"but hands or grippers are farther off: {named}; hold them between predictions: --gripper-dims "
            f"{dims} here, --policy.gripper_dims=[{dims}] of the policy"
        )
    return Judgement("warn" if len(reasons) > 1 else "pass", reasons)


def _to_hold(judged: Stride, floor: NoiseFloor, criteria: Criteria, tolerance: Tolerance) -> list[int]:
    """Moving dimensions that did not count, and are too far off."""
    apart = {*floor.moving} - {*counting(floor, criteria.gripper_dims)} - {*criteria.gripper_dims}
    return [dim for dim in sorted(apart) if judged.shares[dim] > tolerance.value]


def _nothing_moves(floor: NoiseFloor) -> str:
    still = all(found.kind == "constant" for found in floor.dimensions)
    reason = "no action ever changes" if still else "no action moves beyond its own noise"
    return f"{reason}: there is nothing to resolve"


def _too_coarse(judged: Stride, recommended: Stride, tolerance: Tolerance) -> str:
    found = f"chunk_stride={judged.stride} is too coarse: {_deviation(judged, tolerance)} (95 % of the steps)"
    return f"{found}, allowed {tolerance}; take chunk_stride={recommended.stride}"


def _deviation(stride: Stride, tolerance: Tolerance) -> str:
    if tolerance.unit == "mm":
        return f"a gripper is up to {stride.worst:.2g} mm off"
    return f"a joint is up to {stride.worst:.2%} of its range off"
