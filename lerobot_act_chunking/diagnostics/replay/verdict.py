"""The answer in words: does the policy do what was demonstrated, and what should change if not?"""

from collections.abc import Sequence

import numpy as np

from lerobot_act_chunking.diagnostics.core.noise_floor import listed
from lerobot_act_chunking.diagnostics.core.report import Judgement
from lerobot_act_chunking.diagnostics.replay.execution import Gripper, Hesitations
from lerobot_act_chunking.diagnostics.replay.horizon import Following

FEWEST_OBSERVATIONS = 30
FOREIGN = 0.5  # share of a dimension's predictions outside everything demonstrated
CONSTANT = 0.1  # spread of the predictions, by the demonstrated one
COPIES = 0.3  # departure from the last action, or the state, by the demonstrator's
LATE_S, FAR_TOO_LATE_S = 0.15, 0.5
MISSED, MOSTLY_MISSED = 0.2, 0.5  # share of a gripper's switches
HESITATES = 0.05  # share of the frames
LEARNED = (
    "the policy has learned from replayed episodes, so that it may know them by heart: hold some out "
    "(--dataset.episodes of lerobot-train), or record new ones"
)
FROM_UNSEEN = (
    "at the demonstrator's observations it does what was demonstrated; where its own errors lead, only "
    "episodes on the robot or in a simulation show"
)


def judge(
    following: Following | None,
    grippers: Sequence[Gripper],
    hesitations: Hesitations | None,
    names: Sequence[str],
    learned: bool,
    n_observations: int,
) -> Judgement:
    """Hold what was measured against what a policy that has learned does.

    Args:
        following: None where no action moves.
        grippers: that switch.
        hesitations: None where no action moves.
        names: of the action's dimensions.
        learned: whether the policy has learned from any of the replayed episodes.
        n_observations: at which it was asked.
    """
    if following is None or hesitations is None:
        return Judgement("inconclusive", ["no action moves beyond its own noise: there is nothing to follow"])
    if n_observations < FEWEST_OBSERVATIONS:
        few = f"{n_observations} observations are too few to judge by, it takes {FEWEST_OBSERVATIONS}"
        return Judgement("inconclusive", [few])
    findings = [*_chunks(following, names), *_switching(grippers), *_resting(hesitations)]
    if learned:
        findings.append(("warn", LEARNED))
    if not findings:
        return Judgement("pass", [FROM_UNSEEN])
    verdict = "fail" if any(found == "fail" for found, _ in findings) else "warn"
    return Judgement(verdict, [reason for _, reason in findings])


def _chunks(following: Following, names: Sequence[str]) -> list[tuple[str, str]]:
    """What is wrong with the predictions; the first cause alone, since each explains those behind it."""
    foreign = [name for name, share in zip(names, following.outside, strict=True) if share >= FOREIGN]
    if foreign:
        return [("fail", (
            f"most predictions of {listed(foreign)} are far from everything in this dataset: it has other "
            "units, or another calibration or robot, than the policy's training had; record it as that was, "
            "or train on it"
        ))]  # fmt: skip
    if following.variation < CONSTANT:
        return [("fail", (
            f"the policy does nearly the same everywhere (spread {following.variation:.0%} of the "
            "demonstrated one): check that its inputs change (cameras, normalisation), and train for longer"
        ))]  # fmt: skip
    copied = _copied(following)
    if copied:
        return [copied]
    return _against_baselines(following)


def _copied(following: Following) -> tuple[str, str] | None:
    last = following.departure <= following.departure_state
    departure = following.departure if last else following.departure_state
    if departure >= COPIES:
        return None
    what = "its last action" if last else "the current state"
    return "fail", (
        f"the policy repeats {what}: in the first half second it goes {departure:.0%} as far from it as the "
        f"demonstrator, who knows more than that says; give it less to copy (no velocities, n_obs_steps=1, "
        "no state beside cameras), cut idle frames (act-chunking data), predict longer chunks"
    )


def _against_baselines(following: Following) -> list[tuple[str, str]]:
    own, errors = following.errors["policy"], following.errors
    if own >= min(errors["hold_still"], errors["mean_action"]):
        worse = "holding still" if own >= errors["hold_still"] else "always doing the mean action"
        return [("fail", f"the policy is no nearer to the demonstrator than {worse}: train for longer, and "
                 "check that the dataset is of the same task")]  # fmt: skip
    if following.against_nearest is None:
        return []
    ratio, low, high = following.against_nearest
    if ratio <= 1:
        return []
    found = (
        f"its error is {ratio:.2f} times that of repeating the nearest other demonstration (95 % interval "
        f"{low:.2f} to {high:.2f}): it is under-trained, or has too little data: train for longer; if that "
        "does not help, record more"
    )
    return [("fail" if low > 1 else "warn", found)]


def _switching(grippers: Sequence[Gripper]) -> list[tuple[str, str]]:
    found = []
    for each in grippers:
        missed = each.missed / max(each.demonstrated, 1)
        if missed > MISSED:
            found.append(("fail" if missed > MOSTLY_MISSED else "warn", (
                f"{each.name} does not switch at {each.missed} of {each.demonstrated} demonstrated "
                "switches: train for longer, and see that its observations tell when"
            )))  # fmt: skip
        elif each.delays_s and abs(delay := float(np.median(each.delays_s))) > LATE_S:
            when, cure = ("late", "shorten replan_interval, or the latency") if delay > 0 else (
                "early", "train for longer, or cut what demonstrators wait before they grasp"
            )  # fmt: skip
            severe = "fail" if abs(delay) > FAR_TOO_LATE_S else "warn"
            found.append((severe, f"{each.name} switches {abs(delay):.2f} s too {when} (median): {cure}"))
    return found


def _resting(hesitations: Hesitations) -> list[tuple[str, str]]:
    if hesitations.policy_rests <= HESITATES:
        return []
    return [("warn", (
        f"the policy stands still in {hesitations.policy_rests:.0%} of the frames, where the demonstrator "
        f"moves (longest {hesitations.longest_s:.1f} s): cut idle frames of the demonstrations (act-chunking "
        "data), or train for longer"
    ))]  # fmt: skip
