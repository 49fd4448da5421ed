"""When an episode of the SO-101 counts as a success, and how far one got that does not."""

import numpy as np

from lerobot_act_chunking.envs.so_arm.tasks import BOX_INSIDE, CUBE_SIZE
from lerobot_act_chunking.envs.so_arm.world import SoArmWorld

FAILURES = (
    "no contact",  # no finger touched the cube
    "missed grasp",  # one did, but the cube was never lifted
    "dropped",  # it was, is held no longer, and was never in its place
    "not placed",  # the fingers hold it, and it was never in its place
    "not released",  # it is in its place, and a finger touches it
    "fell off",  # it was in its place, and no longer is
    "unsteady",  # it lies in its place, for too short a time
)
"""What an episode without success lacks, in the order of how far it got."""

RELEASED_STEPS = 10
"""Consecutive control steps (1/3 s) for which a cube must rest in its place."""

_LIFTED = 0.012  # [m] over the table at which a touched cube is lifted
_STACKED = 0.004  # [m] off the height of a cube on a cube
_HELD = frozenset(frozenset((finger, "cube")) for finger in ("fixed_finger", "moving_finger"))
_STEADY = 3  # control steps (0.1 s) for which fingers may lose a cube that they hold


class Progress:
    """How far one episode has got, and whether it has succeeded.

    Args:
        world: the simulation, just reset.
    """

    def __init__(self, world: SoArmWorld) -> None:
        self._world = world
        self._touched = self._lifted = self._was_placed = self._has_rested = False
        self._touches, self._place = False, -1
        self._since_touch, self._rested = _STEADY, 0
        self.mode = -1
        """The goal that the cube reached first; -1 before."""

    def update(self) -> None:
        """Take in the present state, once per control step."""
        self._touches = not self._world.contacts().isdisjoint(_HELD)
        self._since_touch = 0 if self._touches else self._since_touch + 1
        self._touched = self._touched or self._touches
        height = float(self._world.position("cube")[2]) - CUBE_SIZE / 2
        self._lifted = self._lifted or (self._touches and height > _LIFTED)
        self._place = place_of(self._world)
        self._was_placed = self._was_placed or self._place >= 0
        self._rested = self._rested + 1 if self._place >= 0 and not self._touches else 0
        if self.mode < 0:
            self.mode = self._place
        self._has_rested = self._has_rested or self._rested >= RELEASED_STEPS

    @property
    def successes(self) -> dict[str, bool]:
        """Whether each rule is satisfied by now."""
        return {"placed": self._was_placed, "released": self._has_rested}

    @property
    def failure(self) -> str:
        """What is missing, one of ``FAILURES``."""
        holds = self._since_touch < _STEADY
        if not self._lifted:
            return "missed grasp" if self._touched else "no contact"
        if not self._was_placed:
            return "not placed" if holds else "dropped"
        if self._place < 0:
            return "fell off"
        return "not released" if holds else "unsteady"


def place_of(world: SoArmWorld) -> int:
    """Which of the task's goals the cube is in, or on; -1 of none."""
    cube = world.position("cube")
    for index, goal in enumerate(world.task.goals):
        off = cube - world.position(goal)
        if goal in world.task.boxes:
            inside = np.abs(off[:2]).max() < BOX_INSIDE / 2 and cube[2] < CUBE_SIZE
        else:
            inside = np.abs(off[:2]).max() < CUBE_SIZE / 2 and abs(off[2] - CUBE_SIZE) < _STACKED
        if inside:
            return index
    return -1
