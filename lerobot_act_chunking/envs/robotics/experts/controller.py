"""What the controllers of the Fetch arm have in common.

An action moves the gripper: x, y, z as shares of ``FULL_ACTION``, then the fingers, 1 opens and -1 closes
them. A controller is a function of the current observation alone, so that a policy can imitate it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

FULL_ACTION = 0.05
"""How far an action of 1 moves the gripper in one control step [m]."""
OPEN, CLOSE, STILL = 1.0, -1.0, 0.0

_NOMINAL = 0.9  # share of the largest action, and of the remaining way, taken in a step
_NEAR, _FAR = 0.03, 0.1  # [m] from a way-point: its shift is gone, its shift is whole
_LIFT, _FUNNEL = 0.08, 4.0  # [m] over the table on the way around an object, and how steeply it is left

Observation = Mapping[str, np.ndarray]
"""Parts of the observation by their names in the table of tasks, positions in metres."""


@dataclass(frozen=True)
class Style:
    """How one episode is moved.

    Attributes:
        speed: its pace.
        shift: (3,) of its free way-point [m].
        overshoot: by how much a movement goes too far, as a share of what is left of it at each step.
    """

    speed: float
    shift: np.ndarray
    overshoot: float = 0.0


@dataclass(frozen=True)
class Move:
    """An action, and what an expert does here that pauses or errs.

    Attributes:
        action: (4,).
        pause: (4,) what is done in a pause before a contact; None where there is no contact.
        pause_after: (4,) the same right after one.
        misses: whether fingers that close now would close on nothing, right above what they are to grasp.
    """

    action: np.ndarray
    pause: np.ndarray | None = None
    pause_after: np.ndarray | None = None
    misses: bool = False


Controller = Callable[[Observation, Style], Move]


def toward(target: np.ndarray, observation: Observation, style: Style) -> np.ndarray:
    """The arm's part (3,) of the action that leads straight to ``target``, slowing down before it."""
    pace = _NOMINAL * style.speed
    way = pace * (1 + style.overshoot) * (target - observation["grip_pos"]) / FULL_ACTION
    return way * min(1.0, pace / max(np.abs(way).max(), 1e-9))


def shifted(waypoint: np.ndarray, observation: Observation, style: Style) -> np.ndarray:
    """A free way-point as this episode has it; the nearer the gripper, the more exact."""
    distance = flat_distance(waypoint, observation["grip_pos"])
    return waypoint + style.shift * np.clip((distance - _NEAR) / (_FAR - _NEAR), 0.0, 1.0)


def flat_distance(a: np.ndarray, b: np.ndarray) -> float:
    """Distance [m] on the table."""
    return float(np.hypot(*(a - b)[:2]))


def raised(point: np.ndarray, height: float) -> np.ndarray:
    """The point ``height`` [m] over ``point``."""
    return point + np.array([0.0, 0.0, height])


def with_fingers(arm: np.ndarray, fingers: float) -> np.ndarray:
    """The whole action (4,)."""
    return np.append(arm, fingers)


def wait(fingers: float) -> np.ndarray:
    """The action (4,) that stays."""
    return with_fingers(np.zeros(3), fingers)


def is_behind(ahead: float, aside: np.ndarray, above: float, tolerance: float) -> bool:
    """Whether a gripper at this place relative to an object [m] may push it on along a line.

    Args:
        ahead: along the line; negative is behind.
        aside: (3,) off the line.
        above: over the object's middle.
        tolerance: off the line where they touch; further behind, more is allowed.
    """
    corridor = tolerance + 0.15 * max(-ahead - 0.05, 0.0)
    return ahead < -0.03 and float(np.linalg.norm(aside)) < corridor and above < 0.025


def go_behind(start: np.ndarray, observation: Observation, style: Style) -> np.ndarray:
    """The arm's part (3,) of the action that leads over the object to ``start``, on the table behind it.

    High while far; near the object sideways only where the fingers are above it.
    """
    gripper, thing = observation["grip_pos"], observation["object_pos"]
    off = flat_distance(start, gripper)
    waypoint = raised(start, np.clip(_FUNNEL * (off - 0.01), 0.0, _LIFT))
    arm = toward(shifted(waypoint, observation, style), observation, style)
    if flat_distance(gripper, thing) < 0.11 and off > 0.015:
        arm[:2] *= np.clip((gripper[2] - thing[2] - 0.02) / 0.04, 0.0, 1.0)
    return arm
