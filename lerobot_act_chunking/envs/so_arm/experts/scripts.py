"""What the arm does in each task: over the cube, down, close, over the goal, open, back home.

The finger that does not move keeps a little distance from the cube while the gripper is open, and comes to it
as the gripper closes. The gripper is vertical where it grasps and where it lets go, and leans outwards high
up, where the wrist could not bend enough.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_act_chunking.envs.so_arm.tasks import CUBE_SIZE, Task
from lerobot_act_chunking.envs.so_arm.world import HOME
from lerobot_act_chunking.envs.strokes import ArmScript, Stroke, miss_grasp

OPEN, CLOSED, HOLDING = 45.0, 3.0, 17.0
"""The gripper's targets, and where it is with a cube between its fingers."""

_RETRY, _MISSED_BY = 1.2, 0.045  # [s] from a missed grasp to the next, and how much too high it is [m]
_GRASP_HEIGHT = CUBE_SIZE / 2 + 0.001
_HIGH, _LEAN = 0.085, -0.3  # [m] and [rad] of the gripper on its way
_OVER_BOX, _ON_CUBE = 0.055, 1.5 * CUBE_SIZE + 0.002  # [m] at which the cube is let go


@dataclass(frozen=True)
class Script:
    """One episode of the arm.

    Attributes:
        arm: its strokes.
        duration: length [s] of an episode without a rest, at nominal pace.
        pauses: moments [s] at which a dwell is inserted.
        pauses_after: moments [s] right after a contact.
    """

    arm: ArmScript
    duration: float
    pauses: tuple[float, ...]
    pauses_after: tuple[float, ...]

    @property
    def beginning(self) -> float:
        """When [s] the first stroke begins; before 0, where an episode without a rest joins it."""
        return min(stroke.start for stroke in (*self.arm.tool, *self.arm.gripper))

    @property
    def end(self) -> float:
        """When [s] the last stroke has ended."""
        return max(stroke.end for stroke in (*self.arm.tool, *self.arm.gripper))


@dataclass(frozen=True)
class _Journey:
    """Where [m] a cube is taken from and to, and how its sides, and those of its goal, are turned [rad]."""

    cube: tuple[float, float]
    turn: float
    goal: tuple[float, float]
    goal_turn: float
    goal_height: float


def smooth(task: Task, places: np.ndarray, home: Sequence[float], mode: int) -> Script:
    """The script for objects at ``places`` (E,): no movement waits for the one before it.

    Args:
        task: whose objects.
        places: ``environment_state``.
        home: (5,) tool pose of the arm at home.
        mode: which of the task's goals.
    """
    way = _journey(task, places, mode)
    over_cube, over_goal = (*way.cube, _HIGH, _LEAN, way.turn), (*way.goal, _HIGH, _LEAN, way.goal_turn)
    arm = ArmScript(
        tool=(
            Stroke(-0.2, 1.35, over_cube, free=True),
            Stroke(0.9, 1.75, (*way.cube, _GRASP_HEIGHT, 0.0, way.turn)),
            Stroke(2.5, 3.3, over_cube, free=True),
            Stroke(2.9, 4.3, over_goal, free=True),
            Stroke(4.05, 4.9, (*way.goal, way.goal_height, 0.0, way.goal_turn)),
            Stroke(5.5, 6.2, over_goal),
            Stroke(5.8, 7.0, tuple(home)),
        ),
        gripper=(
            Stroke(-0.1, 0.8, (OPEN,)),
            Stroke(1.95, 2.35, (CLOSED,)),
            Stroke(5.05, 5.5, (OPEN,)),
            Stroke(6.0, 6.8, HOME[-1:]),
        ),
    )
    return Script(arm, duration=6.8, pauses=(1.9, 5.0), pauses_after=(2.45, 5.5))


def stepwise(task: Task, places: np.ndarray, home: Sequence[float], mode: int) -> Script:
    """The script in which each movement begins when the one before it has ended."""
    way = _journey(task, places, mode)
    over_cube, over_goal = (*way.cube, _HIGH, _LEAN, way.turn), (*way.goal, _HIGH, _LEAN, way.goal_turn)
    arm = ArmScript(
        tool=(
            Stroke(0.1, 1.2, over_cube, free=True),
            Stroke(1.25, 2.0, (*way.cube, _GRASP_HEIGHT, 0.0, way.turn)),
            Stroke(2.55, 3.2, over_cube),
            Stroke(3.25, 4.35, over_goal),
            Stroke(4.4, 5.0, (*way.goal, way.goal_height, 0.0, way.goal_turn)),
            Stroke(5.65, 6.25, over_goal),
            Stroke(6.3, 7.3, tuple(home)),
        ),
        gripper=(
            Stroke(0.2, 1.1, (OPEN,)),
            Stroke(2.05, 2.5, (CLOSED,)),
            Stroke(5.15, 5.6, (OPEN,)),
            Stroke(6.3, 7.2, HOME[-1:]),
        ),
    )
    return Script(arm, duration=7.3, pauses=(2.03, 5.07), pauses_after=(2.52, 5.62))


def missing_once(script: Script) -> Script:
    """The script in which the fingers first close above the cube."""

    def later(moments: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(moment + _RETRY for moment in moments)

    arm = miss_grasp(script.arm, height=_MISSED_BY, retry=_RETRY)
    return Script(arm, script.duration + _RETRY, later(script.pauses), later(script.pauses_after))


def _journey(task: Task, places: np.ndarray, mode: int) -> _Journey:
    where = dict(zip(task.environment_names, places.tolist(), strict=True))
    goal = task.goals[mode]
    on_cube = goal in task.cubes
    return _Journey(
        cube=(where["cube_x"], where["cube_y"]),
        turn=_turn_of(where, "cube"),
        goal=(where[f"{goal}_x"], where[f"{goal}_y"]),
        goal_turn=_turn_of(where, goal) if on_cube else 0.0,
        goal_height=_ON_CUBE if on_cube else _OVER_BOX,
    )


def _turn_of(where: dict[str, float], cube: str) -> float:
    return 2 * float(np.arctan2(where[f"{cube}_qz"], where[f"{cube}_qw"]))
