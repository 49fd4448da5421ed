"""How far an episode of a Fetch task with an object got: the name of its failure, unless it succeeds."""

import math
from collections.abc import Mapping

import numpy as np

_PUSHED = (
    "no contact",  # the object never moved
    "missed the goal",  # it moved, and never was at the goal
    "overshot",  # it was at the goal, and no longer is
)
FAILURES: Mapping[str, tuple[str, ...]] = {
    "FetchPush-v4": _PUSHED,
    "FetchSlide-v4": _PUSHED,
    "FetchPickAndPlace-v4": (
        "no contact",  # the block never moved, and the fingers never were around it
        "missed grasp",  # they were, or pushed it, but do not hold it and never lifted it
        "dropped",  # it was lifted, and the fingers do not hold it now
        *_PUSHED[1:],  # the fingers hold it
    ),
}
"""The failures of each task that can tell, in the order of how far an episode got."""

MOVED = 0.001
"""Distance [m] from its place by which an object has moved; left alone, it stays within a micrometre."""
LIFTED = 0.02
"""Height [m] over its place at which a block that is held is lifted, more than tilting it raises it."""
AROUND = 0.035
"""Distance [m] of gripper and block up to which the block is between the fingers."""
_BLOCK, _SLACK = 0.05, 0.01  # the block's side [m]; how far from it is the opening of fingers that hold it


class Progress:
    """How far one episode got.

    Args:
        task: one of ``FAILURES``.
        state: the first one, by names.
    """

    def __init__(self, task: str, state: Mapping[str, np.ndarray]) -> None:
        self._grasps = "missed grasp" in FAILURES[task]
        self._start = state["object_pos"].tolist()
        self._reached = self._holds = self._lifted = self._arrived = False

    def update(self, state: Mapping[str, np.ndarray], *, at_goal: bool) -> None:
        """Take in the state after one control step, and whether the object is at the goal."""
        gripper, fingers, place = (
            state[part].tolist() for part in ("grip_pos", "gripper_state", "object_pos")
        )
        around = self._grasps and math.dist(gripper, place) < AROUND
        self._reached = self._reached or around or math.dist(place, self._start) > MOVED
        self._holds = around and abs(sum(fingers) - _BLOCK) < _SLACK
        self._lifted = self._lifted or (self._holds and place[2] - self._start[2] > LIFTED)
        self._arrived = self._arrived or at_goal

    @property
    def failure(self) -> str:
        """What is missing, one of the task's ``FAILURES``."""
        if not self._reached:
            return "no contact"
        if self._grasps and not self._holds:
            return "dropped" if self._lifted else "missed grasp"
        return "overshot" if self._arrived else "missed the goal"
